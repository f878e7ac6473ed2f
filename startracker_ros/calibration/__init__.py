"""Camera calibration out of star images."""
