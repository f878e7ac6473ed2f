# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs solved: any image of stars, of a camera that may be unknown."""
