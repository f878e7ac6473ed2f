"""Is it right, and how fast: campaigns, benchmarks, data sheet, faults, closed loop."""
