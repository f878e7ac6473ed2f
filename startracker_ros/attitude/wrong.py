"""When an attitude counts as wrong, not merely as noisy."""

WRONG_SIGMAS = 5.0
WRONG_ARCSEC = 60.0
"""On any axis, further off than so many of its own sigma and so many arcseconds on top."""
