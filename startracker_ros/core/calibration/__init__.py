"""Camera calibration from star images."""
