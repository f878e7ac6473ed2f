"""Long simulated flights of several heads: bags of centroids and telemetry, with truth."""
