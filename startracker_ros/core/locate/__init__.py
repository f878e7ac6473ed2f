"""The position of a target from the lines of sight of two observers."""
