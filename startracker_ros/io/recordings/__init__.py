"""What a bag of the star tracker holds, as arrays."""
