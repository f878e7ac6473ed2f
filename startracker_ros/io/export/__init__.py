# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recorded attitudes, tracks and diagnostics in the formats of others."""
