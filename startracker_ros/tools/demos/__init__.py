# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Demos: nodes as processes on the simulated sky, a bag, a picture, a verdict."""
