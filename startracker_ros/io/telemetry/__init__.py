# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Telemetry as flight units send it: packets to bytes and back, and where they are sent."""
