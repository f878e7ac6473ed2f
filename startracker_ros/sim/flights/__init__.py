# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Long simulated flights of several heads: bags of centroids and telemetry, with truth."""
