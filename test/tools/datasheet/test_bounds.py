# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The Cramer-Rao bound of star images and of attitudes."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.core.attitude.estimate import cramer_rao
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.sim.sky.detector import Detector, DetectorOptions
from startracker_ros.tools.datasheet.bounds import (
    attitude_bound, limiting_magnitude, noise_e2, star_image)

WIDE = DetectorOptions(psf_sigma_px=2.0)
CAMERA = Camera.from_fov(256, 256, 3.0)
MIDDLE = np.array([[127.3, 128.1]])


def test_bright_and_faint_stars_reach_the_limits_of_the_textbook():
    # Of a Gaussian much wider than a pixel: sigma^2 / F with photon noise alone, and
    # 8 pi sigma^4 B / F^2 with that of the background alone.
    image = star_image(WIDE, 0.0)
    bright, faint = image.at(np.array([1e7, 1.0]))
    sigma2 = 2.0 ** 2 + 1 / 12
    assert 1 / bright == pytest.approx([sigma2 / 1e7] * 2, rel=0.02)
    assert 1 / faint == pytest.approx([8 * np.pi * sigma2 ** 2 * noise_e2(WIDE)] * 2, rel=0.05)
    assert image.pixels == pytest.approx(4 * np.pi * sigma2, rel=0.01)


def test_the_information_is_that_of_rendered_images():
    options = replace(WIDE, noise=False, background_e=0.0, bias_dn=0.0, bit_depth=16,
                      gain_e_per_dn=0.25, full_well_e=1e6)
    magnitude = np.array([0.0])
    flux_e = Detector(CAMERA, options).flux_e(magnitude)[0]

    def image(shift_px: float) -> np.ndarray:
        detector = Detector(CAMERA, replace(options, zero_flux_e_s=1e4 / options.exposure_s))
        uv = MIDDLE + [shift_px, 0]
        return detector.render(uv, magnitude, np.random.default_rng(1)) * 0.25 / 1e4

    slope = flux_e * (image(0.25) - image(-0.25)) / 0.5
    expected = np.sum(slope ** 2 / (noise_e2(WIDE) + flux_e * image(0.0)))
    assert star_image(WIDE, 0.0).at(np.array([flux_e]))[0, 0] == pytest.approx(expected, rel=0.05)


def test_a_streak_costs_most_along_itself():
    points, streak = star_image(WIDE, 0.0), star_image(WIDE, 20.0)
    along, across = streak.at(np.array([1e4]))[0]
    assert along < across < points.at(np.array([1e4]))[0, 0]
    assert limiting_magnitude(WIDE, 20.0, 5.5) < limiting_magnitude(WIDE, 0.0, 5.5)


def test_the_attitude_bound_is_that_of_equal_errors():
    rng = np.random.default_rng(1)
    uv = rng.uniform(0, 255, (30, 2))
    flux_e = np.full(30, 5e3)
    sigma_px = star_image(WIDE, 0.0).at(flux_e[:1])[0, 0] ** -0.5
    ours = attitude_bound(CAMERA, WIDE, uv, flux_e, np.zeros(3))
    # Pixels off the axis of a field of 3 deg are finer by 0.07 % at most.
    expected = cramer_rao(CAMERA.unproject(uv), np.full(30, sigma_px * CAMERA.pixel_rad))
    assert ours == pytest.approx(expected, rel=3e-3, abs=1e-3 * expected[0, 0])
    fast = attitude_bound(CAMERA, replace(WIDE, motion_smear=True), uv, flux_e,
                          np.radians([0.0, 2.0, 0.0]))
    # A turn about y moves the stars along u: the error about y suffers.
    assert fast[1, 1] > 2 * fast[0, 0] > 2 * ours[0, 0]
    assert np.sqrt(ours[0, 0]) < 0.1 * 42 * ARCSEC
    assert np.isnan(attitude_bound(CAMERA, WIDE, uv[:1], flux_e[:1], np.zeros(3))).all()
