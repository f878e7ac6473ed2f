# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files and wires: bags, images and camera files, exports, telemetry, tables."""
