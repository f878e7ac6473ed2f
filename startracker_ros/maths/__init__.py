"""Small mathematics that every other room may use."""
