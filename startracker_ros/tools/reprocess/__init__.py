"""Recorded flights through the pipeline again, in segments on many workers; comparison of runs."""
