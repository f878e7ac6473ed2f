# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Coma, astigmatism, vignetting, ghosts and second images, measured on rendered stars."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import Detector, DetectorOptions

CAMERA = Camera.from_fov(256, 256, 4.0)
EXACT = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)
CORNER_PX = np.hypot(128, 128)
DIAGONAL = np.array([1, 1]) / np.sqrt(2)


def image_of(uv, artefacts=ArtefactOptions(), magnitude=4.0, camera=CAMERA, **change):
    options = replace(EXACT, **change)
    image = Detector(camera, options, artefacts).render(
        np.array(uv, float), np.full(len(uv), magnitude), np.random.default_rng(1))
    return image * options.gain_e_per_dn


def moments(image, uv, half=28):
    """Return flux, mean (2,) from uv and covariance (2, 2) of the light around uv."""
    u, v = np.rint(uv).astype(int)
    window = image[v - half:v + half + 1, u - half:u + half + 1]
    grid = np.arange(-half, half + 1)
    pixel = np.stack(np.meshgrid(u + grid, v + grid), -1).reshape(-1, 2) - uv
    weight = window.ravel() / window.sum()
    mean = weight @ pixel
    return window.sum(), mean, (pixel - mean).T @ (weight[:, None] * (pixel - mean))


@pytest.mark.parametrize('change', [
    {'coma_corner_px': 8.0}, {'astigmatism_corner_px': 1.5}, {'astigmatism_corner_px': -1.5},
    {'coma_corner_px': 5.0, 'astigmatism_corner_px': 1.0}])
def test_aberrations_move_light_and_lose_none(change):
    uv = [(127.5, 127.5), (190.2, 70.4), (60.3, 200.9), (215.1, 215.3)]
    plain, shaped = image_of(uv), image_of(uv, **change)
    for pixel in np.array(uv):
        assert moments(shaped, pixel)[0] == pytest.approx(moments(plain, pixel)[0], rel=2e-3)
    on_axis = slice(110, 146), slice(110, 146)
    np.testing.assert_allclose(shaped[on_axis], plain[on_axis], atol=0.3)


def test_a_defocused_star_is_a_ring_around_its_position():
    pixel = np.array((127.3, 127.6))
    plain, ring = image_of([pixel]), image_of([pixel], defocus_ring_px=6.0)
    flux, mean, covariance = moments(ring, pixel)
    assert flux == pytest.approx(moments(plain, pixel)[0], rel=2e-3)
    np.testing.assert_allclose(mean, 0, atol=0.02)
    # The ring adds half of the square of its radius to the variance of each axis.
    np.testing.assert_allclose(covariance - moments(plain, pixel)[2], 18 * np.eye(2), atol=0.5)
    assert ring[128, 127] < ring.max() / 10


def test_coma_points_outwards_and_grows_with_the_distance():
    """
    The mean of the uniform zones, circles about 2/3 t L, is a third of the length L.

    Along the tail the variance is that of the centres, (2/3 L)^2 / 12, and half of the mean
    square radius, (L / 3)^2 / 6; across it only the latter. Five zones are 4 % off.
    """
    for share, sign in ((0.4, 1), (0.7, 1), (0.7, -1)):
        pixel = 127.5 + sign * share * CORNER_PX * DIAGONAL
        length_px = 9.0 * share
        image = image_of([pixel], coma_corner_px=9.0)
        _, mean, covariance = moments(image, pixel)
        assert mean @ DIAGONAL == pytest.approx(sign * length_px / 3, rel=0.01)
        across = np.array([1, -1]) / np.sqrt(2)
        assert abs(mean @ across) < 0.01
        plain = 0.64 + 1 / 12
        ring = (length_px / 3) ** 2 / 6
        assert across @ covariance @ across - plain == pytest.approx(ring, rel=0.06)
        assert DIAGONAL @ covariance @ DIAGONAL - plain == pytest.approx(
            ring + (2 / 3 * length_px) ** 2 / 12, rel=0.06)


def test_the_brightest_part_of_coma_is_the_true_position():
    pixel = 127.5 + np.round(0.7 * CORNER_PX * DIAGONAL) + 0.5
    image = image_of([pixel], coma_corner_px=8.0)
    peak = np.array(np.unravel_index(image.argmax(), image.shape))[::-1]
    assert np.abs(peak - pixel).max() <= 1
    assert moments(image, pixel)[1] @ DIAGONAL > 1.5


@pytest.mark.parametrize('astigmatism_px', [0.4, 1.8, -1.2])
def test_astigmatism_widens_along_or_across_the_radius(astigmatism_px):
    for share in (0.4, 0.7):
        pixel = 127.5 + share * CORNER_PX * DIAGONAL
        _, mean, covariance = moments(
            image_of([pixel], astigmatism_corner_px=astigmatism_px), pixel)
        across = np.array([1, -1]) / np.sqrt(2)
        wide, narrow = (DIAGONAL, across) if astigmatism_px > 0 else (across, DIAGONAL)
        added = (astigmatism_px * share ** 2) ** 2
        assert wide @ covariance @ wide == pytest.approx(0.64 + 1 / 12 + added, rel=5e-3)
        assert narrow @ covariance @ narrow == pytest.approx(0.64 + 1 / 12, rel=5e-3)
        assert np.abs(mean).max() < 0.01


def test_vignetting_takes_its_percentage_in_the_corner():
    image = image_of(np.zeros((0, 2)), vignetting_percent=40.0, background_e=1000.0)
    assert image[127:129, 127:129] == pytest.approx(1000.0, abs=0.5)
    assert image[0, 0] == pytest.approx(600.0, rel=6e-3)
    v, u = np.indices(image.shape)
    distance2 = ((u - 127.5) ** 2 + (v - 127.5) ** 2) / CORNER_PX ** 2
    np.testing.assert_allclose(image, 1000 * (1 - 0.4 * distance2), atol=0.3)
    dark = image_of(np.zeros((0, 2)), vignetting_percent=40.0, dark_current_e_s=5000.0)
    assert dark == pytest.approx(500.0)
    star = (200.3, 190.2)
    share = ((np.array(star) - 127.5) ** 2).sum() / CORNER_PX ** 2
    assert image_of([star], vignetting_percent=40.0).sum() == pytest.approx(
        image_of([star]).sum() * (1 - 0.4 * share), rel=2e-3)


def test_ghosts_are_mirrored_at_the_principal_point():
    camera = replace(CAMERA, cx=120.0, cy=140.0)
    star = np.array([70.3, 100.6])
    image = image_of([star], ArtefactOptions(ghost_ratio=0.25), camera=camera)
    ghost = [240.0, 280.0] - star
    flux, mean, _ = moments(image, ghost, half=12)
    assert np.abs(mean).max() < 5e-3
    assert flux == pytest.approx(0.25 * moments(image, star, half=12)[0], rel=2e-3)
    np.testing.assert_allclose(image[:130], image_of([star], camera=camera)[:130])


def test_a_double_exposure_divides_the_light():
    star, shift = np.array([70.3, 100.6]), (30.0, -20.5)
    image = image_of([star], ArtefactOptions(double_exposure_share=0.3,
                                             double_exposure_shift_px=shift))
    total = image_of([star]).sum()
    first, at_first, _ = moments(image, star, half=8)
    second, at_second, _ = moments(image, star + shift, half=8)
    assert first == pytest.approx(0.7 * total, rel=2e-3)
    assert second == pytest.approx(0.3 * total, rel=2e-3)
    assert max(np.abs(at_first).max(), np.abs(at_second).max()) < 5e-3
