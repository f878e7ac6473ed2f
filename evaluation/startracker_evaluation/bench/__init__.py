# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Benchmarks: our figure compared with a peer or a physical bound, from the same run."""
