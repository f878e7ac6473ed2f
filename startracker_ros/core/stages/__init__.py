"""The policy of the star tracker: which stage works on a frame, and which attitude goes out."""
