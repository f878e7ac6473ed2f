"""Benchmarks: our figure beside a peer or a physical bound, from the same run."""
