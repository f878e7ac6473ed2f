"""The stars of one frame: attitude, focal length, and a star that is off."""

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import (
    ARCSEC, attitude_error, conjugate, multiply, quaternion_from_rotation_vector, random_attitude,
    rotate)
from startracker_ros.reprocess.frame_fit import fit_frame, matched

CAMERA = Camera.from_fov(1024, 1024, 12.0)


def scene(seed, stars=12):
    rng = np.random.default_rng(seed)
    uv = rng.uniform(20, 1003, (stars, 2))
    q = random_attitude(rng)
    return q, uv, rotate(q, CAMERA.unproject(uv))


def test_turn_and_focal_length_are_found():
    truth, uv, direction = scene(1)
    turn = np.array([12.0, -7.0, 30.0]) * ARCSEC
    tracked = multiply(truth, conjugate(quaternion_from_rotation_vector(turn)))
    sigma = np.full(len(uv), 0.1)
    fit = fit_frame(CAMERA, tracked, direction, uv, sigma)
    np.testing.assert_allclose(fit.turn_rad, attitude_error(truth, tracked), atol=1e-3 * ARCSEC)
    longer = CAMERA.with_focal_ratio(1.0001)
    fit = fit_frame(CAMERA, truth, direction, longer.project(rotate(conjugate(truth), direction)),
                    sigma)
    change = np.linalg.solve(fit.lens_information, fit.lens_vector)
    assert abs(change[0] - 1e-4) < 1e-7 and abs(change[1]) < 1e-4


def test_a_star_that_is_off_stands_out_to_the_east():
    truth, uv, direction = scene(2, 30)
    east = np.cross([0.0, 0.0, 1.0], direction[0])
    moved = direction[0] + 20 * ARCSEC * east / np.linalg.norm(east)
    uv[0] = CAMERA.project(rotate(conjugate(truth), moved / np.linalg.norm(moved)))
    fit = fit_frame(CAMERA, truth, direction, uv, np.full(len(uv), 0.1))
    np.testing.assert_allclose(fit.residual[0] / ARCSEC, [20.0, 0.0], atol=1.5)
    assert np.abs(fit.residual[1:]).max() < 5 * ARCSEC


def test_tracks_without_a_centroid_are_left_out():
    uv = np.array([[10.0, 10.0], [50.0, 50.0]])
    found = matched(np.array([[10.1, 10.0], [200.0, 20.0]]), np.full(2, 0.1), uv, np.full(2, 0.1))
    assert found.tolist() == [0, -1]
    assert matched(uv, np.full(2, 0.1), np.empty((0, 2)), np.empty(0)).tolist() == [-1, -1]
