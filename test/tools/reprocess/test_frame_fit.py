# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars of one frame: attitude, focal length, and a star that is off."""

import numpy as np
from skies import CAMERA
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, multiply, quaternion_from_rotation_vector, random_attitude,
    rotate)
from startracker_ros.tools.reprocess.frame_fit import fit_frame, Stars


def scene(seed, stars=12):
    rng = np.random.default_rng(seed)
    uv = rng.uniform(20, 1003, (stars, 2))
    q = random_attitude(rng)
    return q, uv, rotate(q, CAMERA.unproject(uv))


def fitted(quaternion, direction, uv, seen=None):
    """Return the fit of stars that are tracked at uv and seen there, or at other centroids."""
    count = len(uv)
    stars = Stars(direction, uv, np.full(count, 0.1), np.full(count, 4.0))
    seen = uv if seen is None else seen
    return fit_frame(CAMERA, quaternion, stars, seen, np.full(len(seen), 0.1),
                     np.full(len(seen), 100.0))


def test_turn_and_focal_length_are_found():
    truth, uv, direction = scene(1)
    turn = np.array([12.0, -7.0, 30.0]) * ARCSEC
    tracked = multiply(truth, conjugate(quaternion_from_rotation_vector(turn)))
    fit = fitted(tracked, direction, uv)
    np.testing.assert_allclose(fit.turn_rad, attitude_error(truth, tracked), atol=1e-3 * ARCSEC)
    longer = CAMERA.with_focal_ratio(1.0001)
    fit = fitted(truth, direction, longer.project(rotate(conjugate(truth), direction)))
    ff, fk, kk, f, k = fit.lens
    change = np.linalg.solve([[ff, fk], [fk, kk]], [f, k])
    assert abs(change[0] - 1e-4) < 1e-7 and abs(change[1]) < 1e-4


def test_a_star_that_is_off_stands_out_to_the_east():
    truth, uv, direction = scene(2, 30)
    east = np.cross([0.0, 0.0, 1.0], direction[0])
    moved = direction[0] + 20 * ARCSEC * east / np.linalg.norm(east)
    uv[0] = CAMERA.project(rotate(conjugate(truth), moved / np.linalg.norm(moved)))
    fit = fitted(truth, direction, uv)
    np.testing.assert_allclose(fit.residual[0] / ARCSEC, [20.0, 0.0], atol=1.5)
    assert np.abs(fit.residual[1:]).max() < 5 * ARCSEC


def test_tracks_without_a_centroid_are_left_out():
    truth, uv, direction = scene(3)
    seen = np.concatenate([uv[1:] + 0.1, [[500.0, 1500.0]]])
    fit = fitted(truth, direction, uv, seen)
    assert fit.star.tolist() == list(range(1, len(uv)))
    np.testing.assert_allclose(fit.zero_point, 4.0 + 5.0)
    assert fitted(truth, direction, uv, seen[:3]) is None
    assert fitted(truth, direction, uv, np.empty((0, 2))) is None


def test_a_star_without_flux_has_no_zero_point():
    truth, uv, direction = scene(4)
    stars = Stars(direction, uv, np.full(len(uv), 0.1), np.full(len(uv), 4.0))
    flux = np.full(len(uv), 100.0)
    flux[2] = 0.0
    fit = fit_frame(CAMERA, truth, stars, uv, np.full(len(uv), 0.1), flux)
    assert np.isnan(fit.zero_point_mag) and np.isnan(fit.zero_point[2])
    assert np.isfinite(fit.turn_rad).all()
