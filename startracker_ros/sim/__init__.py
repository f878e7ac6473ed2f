"""The sky that is simulated, and long flights under it."""
