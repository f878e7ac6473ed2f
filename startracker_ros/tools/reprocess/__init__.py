# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings reprocessed in segments on many workers; comparison of runs."""
