# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The Hipparcos star catalogue, and the on-board catalogue of a camera."""
