# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The synthetic field: stars of the catalogue where the camera model has them."""

import numpy as np
from skies import onboard_stars
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import synthetic_field
from startracker_ros.core.maths.rotation import ARCSEC


def test_the_stars_are_exact():
    camera = Camera.from_fov(640, 480, 15.0)
    onboard = onboard_stars(camera, 2026.0, 6.0)
    centroids, hip = synthetic_field(onboard, camera)
    assert len(centroids) == len(hip) > 10
    assert camera.contains(centroids.uv).all()
    assert (np.diff(centroids.flux) <= 0).all()
    attitude = estimate_attitude(camera.unproject(centroids.uv),
                                 onboard.direction[onboard.index_of(hip)],
                                 centroids.sigma_px * camera.pixel_rad)
    assert attitude.residual_rad.max() < 1e-3 * ARCSEC


def test_a_sky_without_stars_there_gives_an_empty_field():
    camera = Camera.from_fov(512, 512, 2.0)
    onboard = onboard_stars(camera, 2026.0, 0.0)
    centroids, hip = synthetic_field(onboard, camera)
    assert len(centroids) == len(hip) == 0
