"""What benches, campaigns and reports share: rows, bounds, times, the machine, correctness."""
