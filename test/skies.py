# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras, stars, centroids and stamps that tests share."""

from functools import cache
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_pointing, rotate

CAMERA = Camera.from_fov(1024, 1024, 12.0)
"""The default of the simulator."""

SMALL_CAMERA = Camera.from_fov(512, 512, 12.0)
"""Its field on a quarter of the pixels."""

NARROW_CAMERA = Camera.from_fov(1024, 1024, 4.0)
"""Its detector behind a lens with few stars in the field."""

FRAME = 'star_tracker_optical_frame'

START_NS = 1_790_000_000_000_000_000
"""A stamp in 2026."""


def frame(uv: ArrayLike, flux: np.ndarray | None = None, sigma_px: float = 0.1) -> Centroids:
    """Return centroids at uv (N, 2) px, brightest first."""
    uv = np.asarray(uv, float).reshape(-1, 2)
    flux = np.linspace(2e4, 1e3, len(uv)) if flux is None else flux
    return Centroids(uv, flux, np.full(len(uv), 20.0), np.full(len(uv), sigma_px))


@cache
def onboard_stars(camera: Camera, epoch_year: float, magnitude_limit: float = inf
                  ) -> OnboardCatalog:
    """Return the on-board catalogue of a camera."""
    return onboard_catalog(load_catalog(), camera, epoch_year, magnitude_limit)


def synthetic_field(onboard: OnboardCatalog, camera: Camera) -> tuple[Centroids, np.ndarray]:
    """Return the exact centroids of the stars that a camera sees in Orion, and their hip (N,)."""
    q = quaternion_from_pointing(*np.radians([84.0, 0.0, 30.0]))
    star = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    uv = camera.project(rotate(conjugate(q), onboard.direction[star]))
    seen = camera.contains(uv)
    star, uv = star[seen], uv[seen]
    return frame(uv, 1e6 * 10 ** (-0.4 * onboard.magnitude[star])), onboard.hip[star]
