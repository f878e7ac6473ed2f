"""Rotations and small linear algebra, the ground floor of all rooms."""
