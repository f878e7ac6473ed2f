# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fisheye is calibrated from star lists, given its field of view only."""

import numpy as np
import pytest
from skies import onboard_stars
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import random_attitude
from startracker_ros.photographs.calibrate import calibrate_lists

EPOCH_YEAR = 2026.7
LENS = Camera(1024, 768, 440.0, 440.0, 519.0, 377.0, (-0.03, 0.004, 0.0, 0.0), 'equidistant')


@pytest.fixture(scope='module')
def lists():
    rng = np.random.default_rng(1)
    onboard = onboard_stars(LENS, EPOCH_YEAR, 4.5)
    return {i: star_list(onboard, LENS, random_attitude(rng), 0.1, rng, missing=0.1, false=3)[0]
            for i in range(5)}


@pytest.mark.slow
def test_focal_length_centre_and_coefficients_come_back(lists):
    given = Camera.from_fov(1024, 768, np.degrees(LENS.seen_x_rad) * 1.02, 'equidistant')
    used, found = calibrate_lists(lists, given, EPOCH_YEAR, None, (), {})
    camera = found.camera
    assert len(used) == len(lists)
    assert camera.distortion_model == 'equidistant' and 'k2' in found.adjustment.terms
    assert camera.fx == pytest.approx(LENS.fx, abs=4 * found.adjustment.sigmas['focal'])
    assert np.std(found.residual_px) == pytest.approx(0.1, rel=0.15)
    u, v = np.meshgrid(np.linspace(20, 1000, 9), np.linspace(20, 750, 9))
    pixels = np.stack([u.ravel(), v.ravel()], -1)
    assert np.abs(camera.project(LENS.unproject(pixels)) - pixels).max() < 0.2
    assert np.std(found.pinhole_px) > 5 * np.std(found.residual_px)


def test_a_term_that_a_fisheye_does_not_have_is_rejected(lists):
    with pytest.raises(CalibrationError, match='tangential: equidistant does not have it'):
        calibrate_lists(lists, LENS, EPOCH_YEAR, None, ('k1', 'tangential'), {})
