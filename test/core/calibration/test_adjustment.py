# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated skies through a known lens: the lens comes back, with honest errors."""

from dataclasses import replace

import numpy as np
import pytest
from skies import onboard_stars
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.calibration.adjustment import adjust, CalibrationError, MatchedStars
from startracker_ros.core.calibration.estimate import calibrate, covered_percent, star_shift
from startracker_ros.core.calibration.matching import match_stars, View
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

LENS = Camera(1024, 768, 2850.0, 2850.0, 519.0, 377.0, (-0.25, 0.4, 8e-4, -6e-4, 0.0))
START = Camera(1024, 768, 2862.0, 2862.0, 511.5, 383.5)
TERMS = ('focal', 'k1', 'centre', 'tangential', 'k2')
ONBOARD = onboard_stars(LENS, 2026.7, 7.0)
# A k1 that the start does not know moves stars by more than the widest gate.
MILD = replace(LENS, distortion=(-0.12, 0.0, 0.0, 0.0, 0.0))


def sky(rng, frames, camera=LENS, sigma_px=0.1, **kwargs):
    """Return views of random pointings, the attitudes as an ideal camera would see them."""
    views = []
    for _ in range(frames):
        spots, hip = star_list(ONBOARD, camera, random_attitude(rng), sigma_px, rng, **kwargs)
        views.append(View(spots, apparent_attitude(spots, hip)))
    return views


def apparent_attitude(spots, hip):
    true = hip > 0
    return estimate_attitude(START.unproject(spots.uv[true]),
                             ONBOARD.direction[ONBOARD.index_of(hip[true])],
                             spots.sigma_px[true]).quaternion


def known(rng, frames, sigma_px=0.1):
    """Return the stars of frames with their true directions, and approximate attitudes."""
    parts, attitudes = [], []
    for frame in range(frames):
        q = random_attitude(rng)
        spots, hip = star_list(ONBOARD, LENS, q, sigma_px, rng)
        star = ONBOARD.index_of(hip)
        parts.append((spots.uv, spots.sigma_px, ONBOARD.direction[star],
                      np.full(len(hip), frame), spots.flux, hip, ONBOARD.magnitude[star]))
        attitudes.append(multiply(q, quaternion_from_rotation_vector(rng.normal(0, 3e-4, 3))))
    return MatchedStars(*(np.concatenate(part) for part in zip(*parts))), np.array(attitudes)


def errors(found):
    truth = dict(zip(('focal', 'cx', 'cy', 'k1', 'k2', 'p1', 'p2', 'k3'),
                     (LENS.fx, LENS.cx, LENS.cy, *LENS.distortion)))
    return np.array([found.values[name] - truth[name] for name in found.parameters])


def test_errors_are_as_large_as_the_covariance_says():
    squares, axes = [], []
    for seed in range(50):
        stars, attitudes = known(np.random.default_rng(seed), 6)
        found = adjust(START, stars, attitudes, TERMS)
        error = errors(found)
        squares.append(error @ np.linalg.solve(found.covariance, error))
        axes.append(error / np.sqrt(np.diag(found.covariance)))
    count = len(found.parameters)
    low, high = mean_chi_square_bounds(count, len(squares))
    assert low < np.mean(squares) < high, (low, np.mean(squares), high)
    assert np.abs(axes).max() < 4.2
    assert np.abs(np.mean(axes, axis=0)).max() < 3.5 / np.sqrt(50)


def test_errors_of_the_centroids_that_are_larger_than_they_say_widen_the_covariance():
    stars, attitudes = known(np.random.default_rng(1), 8, sigma_px=0.3)
    honest = adjust(START, stars, attitudes, TERMS)
    found = adjust(START, replace(stars, sigma_px=stars.sigma_px / 10), attitudes, TERMS)
    assert found.extra_px == pytest.approx(0.3, rel=0.1)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(honest.covariance), rtol=0.25)


def test_wrong_stars_are_left_out():
    rng = np.random.default_rng(2)
    stars, attitudes = known(rng, 8)
    wrong = rng.random(len(stars)) < 0.1
    icrf = stars.icrf.copy()
    # Another star of the same frame: a wrong identification, not just noise.
    icrf[wrong] = np.where((np.roll(stars.frame, 3) == stars.frame)[wrong, None],
                           np.roll(stars.icrf, 3, axis=0)[wrong], -stars.icrf[wrong])
    in_front = np.einsum('ij,ij->i', icrf, stars.icrf) > 0
    stars, wrong = replace(stars, icrf=icrf).select(in_front), wrong[in_front]
    found = adjust(START, stars, attitudes, TERMS)
    assert not found.used[wrong].any()
    assert found.used[~wrong].mean() > 0.99
    error = errors(found)
    assert error @ np.linalg.solve(found.covariance, error) < 25


def test_an_undetermined_term_has_a_very_large_error():
    """Distortion from stars in the middle alone: the covariance must not look sound."""
    stars, attitudes = known(np.random.default_rng(3), 6)
    stars = stars.select(np.hypot(*(stars.uv - [511, 383]).T) < 60)
    found = adjust(START, stars, attitudes, ('focal', 'k3'))
    assert found.sigmas['k3'] > 1e4


def test_too_few_stars_to_adjust():
    stars, attitudes = known(np.random.default_rng(4), 2)
    with pytest.raises(CalibrationError, match='5 stars in 2 images: too few for 7 parameters'):
        adjust(START, stars.select(np.arange(5)), attitudes, TERMS)


def test_the_data_choose_the_terms_and_the_edges_come_in():
    rng = np.random.default_rng(5)
    found = calibrate(sky(rng, 8, MILD, missing=0.1, false=5), START, ONBOARD)
    assert found.adjustment.terms == ('focal', 'k1', 'centre')
    assert found.held['k2'] == 'does not differ from zero'
    error = found.adjustment.values['k1'] + 0.12
    assert abs(error) < 3 * found.adjustment.sigmas['k1']
    corner = np.abs(found.stars.uv - [511.5, 383.5]) > [450, 330]
    assert corner.all(axis=1).sum() > 3
    assert covered_percent(MILD, found.stars.uv) > 90
    # The ideal lens is off by pixels at the edges, the calibrated one by the centroids alone.
    assert np.std(found.pinhole_px) > 3 * np.std(found.residual_px)
    assert np.std(found.residual_px) == pytest.approx(0.1, rel=0.1)
    assert np.std(found.left_out_px) < 1.15 * np.std(found.residual_px)


def test_a_lens_of_all_terms():
    found = calibrate(sky(np.random.default_rng(6), 20), START, ONBOARD, TERMS[1:])
    error = errors(found.adjustment)
    assert np.abs(error / np.sqrt(np.diag(found.adjustment.covariance))).max() < 3


def test_an_image_with_a_wrong_attitude_is_left_out():
    rng = np.random.default_rng(7)
    views = sky(rng, 6, MILD)
    views[2] = View(views[2].centroids, random_attitude(rng))
    assert calibrate(views, START, ONBOARD).frames.tolist() == [0, 1, 3, 4, 5]


@pytest.mark.parametrize('frames, words', [
    (0, '0 identified images, at least 2'), (1, '1 identified images, at least 2')])
def test_one_image_is_not_enough(frames, words):
    with pytest.raises(CalibrationError, match=words):
        calibrate(sky(np.random.default_rng(8), frames, MILD), START, ONBOARD)


def test_images_of_one_pointing_are_rejected():
    rng = np.random.default_rng(9)
    q = random_attitude(rng)
    views = []
    for _ in range(5):
        spots, hip = star_list(ONBOARD, MILD, q, 0.1, rng)
        views.append(View(spots, apparent_attitude(spots, hip)))
    with pytest.raises(CalibrationError, match='same pointing.*principal point'):
        calibrate(views, START, ONBOARD)


def test_what_is_not_determined_is_named():
    """Stars in the middle of the field only; few stars."""
    rng = np.random.default_rng(10)
    views = sky(rng, 5, MILD)
    middle = [View(view.centroids.select(np.hypot(
        *(view.centroids.uv - [511.5, 383.5]).T) < 200), view.quaternion) for view in views]
    with pytest.raises(CalibrationError, match='k1 is not determined: its 1 sigma error'):
        calibrate(middle, START, ONBOARD, ('k1', 'k2'))
    found = calibrate(middle, START, ONBOARD)
    assert 'k1' not in found.adjustment.terms
    assert 'k1 is not determined' in found.held['k1']
    assert found.camera.distortion == (0.0,) * 5
    few = [View(view.centroids.select(slice(6)), view.quaternion) for view in views[:4]]
    with pytest.raises(CalibrationError, match='stars, at least 30 are needed: focal length'):
        calibrate(few, START, ONBOARD)


def test_centroids_that_are_not_numbers_are_left_out():
    rng = np.random.default_rng(11)
    views = sky(rng, 4, MILD)
    spots = views[0].centroids
    uv, sigma_px = spots.uv.copy(), spots.sigma_px.copy()
    uv[0], sigma_px[1], sigma_px[2] = np.nan, np.nan, 0.0
    views[0] = View(Centroids(uv, spots.flux, spots.snr, sigma_px), views[0].quaternion)
    stars = match_stars(START, ONBOARD, views, [view.quaternion for view in views], 3.0)
    assert np.isfinite(stars.uv).all() and (stars.sigma_px > 0).all()
    found = calibrate(views, START, ONBOARD)
    assert np.isfinite(found.adjustment.covariance).all()


def test_how_far_stars_move_in_the_image():
    q = random_attitude(np.random.default_rng(12))
    turns = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0, 0.1]])
    shift = star_shift(START, q, multiply(q, quaternion_from_rotation_vector(turns)))
    np.testing.assert_allclose(shift * 1024, [0, 0.02 * 2862, 0.1 * 640], rtol=1e-3, atol=1e-6)
