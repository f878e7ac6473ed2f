# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stray light of the Earth, the Moon or the Sun from one side of the image."""

import numpy as np
from startracker_ros.core.camera.model import Camera


def stray_light(camera: Camera, *, peak_e: float, angle_deg: float,
                falloff_deg: float) -> np.ndarray:
    """
    Return electrons (H, W) float32 that fall off exponentially away from the source.

    The source lies outside the image, in the direction angle_deg from +u towards +v. The image
    is brightest, peak_e, at the point nearest to it; over falloff_deg the light drops by a
    factor e.
    """
    if not peak_e:
        return np.zeros((camera.height, camera.width), np.float32)
    angle = np.radians(angle_deg)
    across = np.cos(angle) * np.arange(camera.width)
    down = np.sin(angle) * np.arange(camera.height)
    # The exponential of a sum is a product: one exponential for each row and column.
    columns, rows = (np.exp((towards - towards.max()) * camera.pixel_rad / np.radians(falloff_deg))
                     for towards in (across, down))
    return np.outer(peak_e * rows, columns).astype(np.float32)
