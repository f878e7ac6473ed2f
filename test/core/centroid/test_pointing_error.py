# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors that all stars of an image share, by motion that is not uniform in the exposure."""

import numpy as np
import pytest
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.centroid.streak import Streak

SIGMA_PX, SIDE_PX = 0.9, 256
# (uv (K, 2) px, dwell (K,)) of the pointing during an exposure, about its mean.
KICK = np.array([[0.0, 0.0], [5.0, 3.0]]), np.array([0.6, 0.4])
TAIL = np.array([[0.0, 0.0], *([0.5 * k, 0.0] for k in range(1, 9))]), np.array(
    [0.6, *[0.05] * 8])


def image_of(path, rng, stars=12, moves=lambda index: True, fluxes=None):
    """Return an image of stars, some moved along a path, and the mean positions."""
    offset, dwell = path
    uv = np.stack(np.meshgrid(np.arange(30, 240, 48), np.arange(30, 240, 48)), -1
                  ).reshape(-1, 2)[:stars] + rng.uniform(-5, 5, (stars, 2))
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    light = np.full((SIDE_PX, SIDE_PX), 50.0)
    if fluxes is None:
        fluxes = 10 ** rng.uniform(3.3, 4.3, stars)
    for index, (star, flux) in enumerate(zip(uv, fluxes)):
        moved = (offset - dwell @ offset) * moves(index)
        for away, share in zip(moved, dwell):
            squared = (x - star[0] - away[0]) ** 2 + (y - star[1] - away[1]) ** 2
            light += share * flux / (2 * np.pi * SIGMA_PX ** 2) * np.exp(
                -squared / (2 * SIGMA_PX ** 2))
    return rng.poisson(light).clip(0, 65535).astype(np.uint16), uv


def fitted_less_mean(centroids, uv):
    """Return the median offset (2,) of the six brightest centroids from the mean positions."""
    away = centroids.uv[:6, None] - uv
    nearest = np.linalg.norm(away, axis=-1).argmin(axis=1)
    return np.median(away[np.arange(len(away)), nearest], axis=0)


@pytest.mark.parametrize('path', [KICK, TAIL], ids=['kick', 'tail'])
def test_the_error_of_the_fits_is_within_the_common_covariance(path):
    rng = np.random.default_rng(1)
    image, uv = image_of(path, rng)
    centroids = CentroidExtractor().measure(image).centroids
    error, common = fitted_less_mean(centroids, uv), centroids.correlated_error
    assert np.hypot(*error) > 0.1
    eigenvalue, vector = np.linalg.eigh(common)
    offset, dwell = path
    motion_px = np.sqrt(dwell @ np.sum(offset ** 2, axis=1))
    assert abs(vector[:, 1] @ error) < np.sqrt(eigenvalue[1]) < 1.2 * motion_px
    along = error / np.hypot(*error)
    assert abs(along @ vector[:, 1]) > 0.95


def test_images_as_they_should_be_have_no_correlated_error():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        image, _ = image_of((np.zeros((1, 2)), np.ones(1)), rng)
        extraction = CentroidExtractor().measure(image)
        assert len(extraction.centroids) >= 10
        assert not extraction.centroids.common.any()


def test_companions_of_some_stars_are_not_motion():
    for seed in range(3):
        image, _ = image_of(KICK, np.random.default_rng(seed),
                            moves=lambda index: index % 6 == 0)
        assert not CentroidExtractor().measure(image).centroids.common.any()


def test_three_bright_stars_without_any_motion_outweigh_faint_ones():
    """Where the faint ones have companions."""
    fluxes = np.full(12, 2e3)
    fluxes[::4] = 2e4
    image, _ = image_of(KICK, np.random.default_rng(1), moves=lambda index: index % 4 > 0,
                        fluxes=fluxes)
    assert not CentroidExtractor().measure(image).centroids.common.any()


def test_a_uniform_streak_has_no_correlated_error_and_a_hooked_one_has():
    time = (np.arange(33) + 0.5) / 33 - 0.5
    uniform = np.outer(time, [8.0, 4.0]), np.full(33, 1 / 33)
    hooked = uniform[0], np.where(np.arange(33) < 4, 4.0, 1.0) / 45
    streak = Streak(8.0, 4.0, 0.0, 127.5, 127.5)
    extractor = CentroidExtractor()
    # The width of the stars is that of an image without motion.
    still, _ = image_of((np.zeros((1, 2)), np.ones(1)), np.random.default_rng(2))
    _, searched = extractor.search(still)
    for path, moved in ((uniform, False), (hooked, True)):
        image, uv = image_of(path, np.random.default_rng(3))
        centroids = extractor.search(image, streak, searched)[0].centroids
        assert len(centroids) >= 8
        assert centroids.common.any() == moved
    error = fitted_less_mean(centroids, uv)
    assert error @ np.linalg.solve(centroids.correlated_error + 1e-4 * np.eye(2), error) < 4


def test_static_asymmetry_of_the_stars_costs_what_it_moves_them_and_no_more():
    """Three lobes have their centre of light at the fit, though no lobe faces another."""
    angle = np.radians([90, 210, 330])
    lobes = np.vstack([np.zeros(2), 3.0 * np.stack([np.cos(angle), np.sin(angle)], -1)])
    image, _ = image_of((lobes, np.array([0.7, 0.1, 0.1, 0.1])), np.random.default_rng(3))
    common = CentroidExtractor().measure(image).centroids.correlated_error
    assert 0 < np.sqrt(np.trace(common)) < 0.35
