"""Following identified stars from frame to frame."""
