"""Attitude of a body out of several star trackers and a gyro, and the mounts of the heads."""
