"""Whole systems of node processes: demos, faults, soak, latency."""
