# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What drifts and what steps over weeks: lenses, mounts between heads, zero points, stars."""
