# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras, stars and stamps that tests share; each is made once in a process."""

from functools import cache
from math import inf

from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog

CAMERA = Camera.from_fov(1024, 1024, 12.0)
"""The default of the simulator."""

SMALL_CAMERA = Camera.from_fov(512, 512, 12.0)
"""Its field on a quarter of the pixels."""

NARROW_CAMERA = Camera.from_fov(1024, 1024, 4.0)
"""Its detector behind a lens with few stars in the field."""

FRAME = 'star_tracker_optical_frame'

START_NS = 1_790_000_000_000_000_000
"""A stamp in 2026."""


@cache
def onboard_stars(camera: Camera, epoch_year: float, magnitude_limit: float = inf
                  ) -> OnboardCatalog:
    """Return the on-board catalogue of a camera."""
    return onboard_catalog(load_catalog(), camera, epoch_year, magnitude_limit)
