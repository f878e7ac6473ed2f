# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What benches, campaigns and reports share: rows, bounds, times, the machine, correctness."""
