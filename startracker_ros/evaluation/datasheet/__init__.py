"""What a data sheet states of a camera with this star tracker, and what a design will reach."""
