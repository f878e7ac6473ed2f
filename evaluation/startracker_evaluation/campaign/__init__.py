# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Campaigns: the published tables repeated, the paper's figure compared with ours."""
