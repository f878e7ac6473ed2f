"""What drifts and what steps over weeks: lenses, mounts between heads, zero points, stars."""
