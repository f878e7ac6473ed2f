# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Is it right, and how fast: campaigns, benchmarks, faults, closed loop."""
