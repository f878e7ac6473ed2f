# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time limit of what a test waits for."""

HANGS_S = 300.0
"""After this time a process hangs: on a busy machine all takes ten times as long, or more."""
