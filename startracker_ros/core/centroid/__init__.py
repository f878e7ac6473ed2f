# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star image to centroids: background, detection, fit and what to reject."""
