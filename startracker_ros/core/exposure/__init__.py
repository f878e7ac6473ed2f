# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exposure time and gain by the stars."""
