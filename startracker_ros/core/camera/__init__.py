"""The camera: projection, lens distortion, camera files, image files."""
