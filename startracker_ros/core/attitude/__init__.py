"""Attitude from star directions, with its uncertainty."""
