# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fields of view that are searched where none is known, of the long side; imports nothing."""

LOWEST_DEG, HIGHEST_DEG = 0.6, 120.0
"""With the catalogue of the package (blind.py)."""

TILED_LOWEST_DEG, TILED_HIGHEST_DEG = 0.3, 2.0
"""With a catalogue of the user (tiled.py), unless that is made for wider ones."""
