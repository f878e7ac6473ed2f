# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude in a control loop: Basilisk's spacecraft and flight software around ours."""
