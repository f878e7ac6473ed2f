# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whole systems of node processes: demos, faults, soak, latency."""
