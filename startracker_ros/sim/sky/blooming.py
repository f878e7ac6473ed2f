# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Blooming: charge above the full well flows along the columns of a CCD."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def bloom(light: np.ndarray, full_well_e: float) -> None:
    """
    Move the charge of light (H, W) float32 above full_well_e along its column.

    Half of the excess of each pixel flows up, half down, and fills every pixel to the full well
    until none is left; what reaches the edge of the image is lost. Full pixels end eight
    standard deviations of the photon noise above the full well, at which the read-out clips:
    a full pixel has no photon noise.
    """
    height, width = light.shape
    full = np.float32(full_well_e)
    brim = full + np.float32(8) * np.sqrt(full)
    carried = np.zeros(width, np.float32)
    for row in range(height):
        _flow(light[row], carried, full)
    carried[:] = 0
    for row in range(height - 1, -1, -1):
        _flow(light[row], carried, full)
        for column in range(width):
            if light[row, column] >= full:
                light[row, column] = brim


@compiled
def _flow(line: np.ndarray, carried: np.ndarray, full: np.float32) -> None:
    """Fill one row (W,) with the charge carried (W,) to it, and add half of its own excess."""
    for column in range(len(line)):
        room = full - line[column]
        if room < 0:
            carried[column] -= room / np.float32(2)
        elif carried[column] > 0:
            if carried[column] < room:
                line[column] += carried[column]
                carried[column] = 0
            else:
                line[column] = full
                carried[column] -= room
