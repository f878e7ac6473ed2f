"""The stars around an attitude are those of the catalogue's own search, wherever it turns."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera.lens import project
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.catalog.onboard import onboard_catalog
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.maths.rotation import conjugate, quaternion_from_pointing, rotate
from startracker_ros.track.in_view import StarsInView

PLAIN = Camera.from_fov(512, 512, 20.0)
DISTORTED = replace(PLAIN, distortion=(-0.1, 0.02, 1e-3, -5e-4, 0.0))
FISHEYE = Camera(512, 512, 200.0, 200.0, 250.0, 260.0, (-0.02, 0.004, 0.0, 0.0), 'equidistant')


@pytest.mark.parametrize('camera', [PLAIN, DISTORTED, FISHEYE])
def test_as_the_catalogue_and_the_camera_say(camera):
    onboard = onboard_catalog(load_catalog(), camera, 2026.0, 6.0)
    stars = StarsInView(camera, ApparentCatalog(onboard))
    # Small steps, which keep the stars of the search before, and leaps.
    for ra_deg in (10.0, 10.1, 10.4, 10.9, 200.0, 10.0):
        q = quaternion_from_pointing(*np.radians([ra_deg, 40.0, 3 * ra_deg]))
        index, sensor, uv = stars.of(
            AttitudeEstimate(q, np.eye(3) * 1e-12, 9, np.zeros(9), 9.0))
        expected = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
        assert len(index) > 20
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_allclose(sensor, rotate(conjugate(q), onboard.direction[index]),
                                   atol=1e-14)
        np.testing.assert_allclose(uv, camera.project(sensor), atol=1e-9)


@pytest.mark.parametrize('camera', [PLAIN, DISTORTED])
def test_projects_as_the_camera(camera):
    directions = np.random.default_rng(1).normal(0, 1, (100, 3))
    directions[:, 2] = np.where(np.arange(100) % 10, 5 + directions[:, 2], directions[:, 2])
    np.testing.assert_allclose(project(camera.lens, directions), camera.project(directions),
                               rtol=1e-12, atol=1e-9)
