# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What people run: command line, doctor, report, reprocess, trend, live, demos."""
