# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Discs of the Moon and the Earth in the image."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.artefacts import ArtefactOptions


class Disc(NamedTuple):
    """
    A disc with a soft limb, fixed on the sensor.

    distance_deg is the angle from the boresight to its centre, angle_deg the direction of the
    centre in the image from +u towards +v. Over softness_deg about radius_deg the brightness
    peak_e falls from 0.62 to 0.38 of that of the disc: a logistic curve.
    """

    peak_e: float
    radius_deg: float
    distance_deg: float
    angle_deg: float
    softness_deg: float


def pixel_directions(camera: Camera) -> np.ndarray:
    """Return the unit vectors (H, W, 3) of all pixels on sensor axes."""
    return camera.unproject(np.stack(
        np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1))


def disc_coverage(direction: np.ndarray, disc: Disc) -> np.ndarray:
    """
    Return the part (H, W) float32 of each pixel that a disc covers: 1 inside, 0 outside.

    direction (H, W, 3) are the pixel_directions() of the camera.
    """
    distance, angle = np.radians([disc.distance_deg, disc.angle_deg])
    centre = np.array([np.sin(distance) * np.cos(angle), np.sin(distance) * np.sin(angle),
                       np.cos(distance)])
    away_deg = np.degrees(np.arccos(np.clip(direction @ centre, -1, 1)))
    outside = np.clip((away_deg - disc.radius_deg) / disc.softness_deg, -80, 80)
    return (1 / (1 + np.exp(outside))).astype(np.float32)


def discs(options: ArtefactOptions) -> list[Disc]:
    """Return the discs of the Moon and the Earth that the options have."""
    moon = Disc(options.moon_e, options.moon_radius_deg, options.moon_distance_deg,
                options.moon_angle_deg, options.moon_softness_deg)
    earth = Disc(options.earth_e, options.earth_radius_deg, options.earth_distance_deg,
                 options.earth_angle_deg, options.earth_softness_deg)
    return [disc for disc in (moon, earth) if disc.peak_e]
