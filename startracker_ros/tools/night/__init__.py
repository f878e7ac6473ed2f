# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a real night states of a camera: the Earth turns the sky by a law that is known."""
