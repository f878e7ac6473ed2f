"""Images of files: solve, calibrate, and what they write."""
