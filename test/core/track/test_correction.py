# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The correction of a predicted attitude by all stars of a frame, without outliers."""

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import round_errors
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, multiply, quaternion_from_pointing, quaternion_from_rotation_vector,
    rotate)
from startracker_ros.core.track.association import DetectionModel, gate_size
from startracker_ros.core.track.correction import correct, on_image
from startracker_ros.core.track.motion_models import image_jacobian

CAMERA = Camera(1024, 1024, 4870.0, 4880.0, 505.0, 520.0, (-0.1, 0.05, 1e-3, -1e-3, 0.0))
Q = quaternion_from_pointing(1.0, 0.3, 0.2)
SIGMA_RAD = 1e-4
SIGMA_PX = 0.05
DETECTION = DetectionModel(gate_size(0.9999), 0.9999, 0.95, 1024.0 ** 2)
TURN = np.array([1e-4, -2e-4, 1.5e-3])


def state():
    covariance = np.diag(np.repeat([SIGMA_RAD, 1e-3, 1e-5], 3) ** 2)
    covariance[2, 2] = 1e-6
    return AttitudeState(1, Q, np.radians([0.1, 0.2, 0.3]), np.zeros(3), covariance)


def stars(count):
    """Return directions (N, 3) all over the image."""
    uv = np.random.default_rng(1).uniform(50, 970, (count, 2))
    return rotate(Q, CAMERA.unproject(uv))


def pixels(icrf, turn):
    """Return where the stars are after a turn about sensor axes."""
    q = multiply(Q, quaternion_from_rotation_vector(turn))
    return CAMERA.project(rotate(conjugate(q), icrf))


def corrected(icrf, uv, usable=None, delay_s=None):
    return correct(CAMERA.lens, icrf, np.ones(len(icrf), bool) if usable is None else usable, 4,
                   state(), uv, round_errors(np.full(len(uv), SIGMA_PX ** 2)),
                   np.zeros(len(uv)) if delay_s is None else delay_s, DETECTION)


def test_the_turn_of_the_stars_is_found():
    icrf = stars(30)
    order = np.random.default_rng(2).permutation(30)
    false = np.array([[5.0, 5.0], [1000.0, 3.0]])
    found = corrected(icrf, np.concatenate([pixels(icrf, TURN)[order], false]))
    error = attitude_error(found.state.quaternion, Q)
    # The weight of the prediction is about a hundredth of that of the stars.
    assert found.agreed and found.inlier.all()
    np.testing.assert_allclose(error, TURN, rtol=0.05)
    assert found.normalised.max() < 1
    np.testing.assert_array_equal(found.probability[:, 1:].argmax(axis=1), np.argsort(order))
    np.testing.assert_array_equal(np.flatnonzero(found.unassociated), [30, 31])
    # The turn is 1, 2 and 1.5 sigma of the innovation covariance.
    np.testing.assert_allclose(np.abs(found.innovation), [1, 2, 1.5], rtol=0.1)


def test_the_worst_outlier_is_removed_first():
    icrf = stars(12)
    uv = pixels(icrf, np.zeros(3))
    uv[3] += [0.9, 0.0]
    found = corrected(icrf, uv)
    np.testing.assert_array_equal(np.flatnonzero(~found.inlier), [3])
    assert found.normalised[3] > 5 and found.normalised[found.inlier].max() < 0.01


def test_stars_outside_the_image_or_not_usable_do_not_count():
    icrf = np.concatenate([stars(10), rotate(Q, [[0.0, 0.0, -1.0], [1.0, 0.0, 1.0]])])
    usable = np.arange(12) != 4
    uv = pixels(icrf[:10], np.zeros(3))
    uv[4] += 0.3
    found = corrected(icrf, uv, usable)
    np.testing.assert_array_equal(np.flatnonzero(~found.inside), [10, 11])
    assert found.predicted.shape == (10, 2)
    np.testing.assert_array_equal(np.flatnonzero(~found.inlier), [4])
    np.testing.assert_allclose(found.state.quaternion, Q, atol=1e-12)


def test_too_few_stars_agree_on_nothing():
    icrf = stars(8)
    for uv in (np.empty((0, 2)), pixels(icrf[:3], np.zeros(3))):
        found = corrected(icrf, uv)
        assert not found.agreed and not found.innovation.any()
        assert np.count_nonzero(np.isfinite(found.distance)) == 0
        assert found.probability.shape == (8, len(uv) + 1)


def test_stars_of_a_rolling_shutter_measure_the_rate_as_well():
    """By the information filter of six states, of all stars and of the attitude that is left."""
    rng, icrf, before = np.random.default_rng(5), stars(40), state()
    delay_s = rng.uniform(-0.03, 0.05, 40)
    turn, change = TURN / 10, np.array([2e-3, -1e-3, 1.5e-3])
    uv = np.array([pixels(one[None], turn + change * late)[0]
                   for one, late in zip(icrf, delay_s)]) + rng.normal(0, SIGMA_PX, (40, 2))
    found = corrected(icrf, uv, delay_s=delay_s)
    flow = image_jacobian(CAMERA, CAMERA.unproject(pixels(icrf, np.zeros(3))))
    design = np.concatenate([flow, delay_s[:, None, None] * flow], -1).reshape(-1, 6) / SIGMA_PX
    measured = (uv - pixels(icrf, np.zeros(3))).reshape(-1) / SIGMA_PX
    P = np.linalg.inv(np.linalg.inv(before.covariance[:6, :6]) + design.T @ design)
    x = P @ design.T @ measured
    assert found.inlier.all()
    np.testing.assert_allclose(found.state.covariance[:6, :6], P, rtol=0.02, atol=1e-13)
    np.testing.assert_allclose(
        attitude_error(found.state.quaternion, Q), x[:3], atol=0.1 * np.sqrt(P[0, 0]))
    np.testing.assert_allclose(
        found.state.rate - before.rate, x[3:], atol=0.1 * np.sqrt(P[3, 3]))
    # The attitude by the stars alone is known less well than with a known rate.
    loose = np.linalg.inv(design.T @ design)[:3, :3]
    tight = np.linalg.inv((design.T @ design)[:3, :3])
    assert (np.diag(tight) < np.diag(found.turn_covariance)).all()
    assert (np.diag(found.turn_covariance) < np.diag(loose)).all()
    np.testing.assert_allclose(found.turn, turn, atol=4 * np.sqrt(loose[0, 0]))


def test_an_acceleration_changes_what_a_rolling_shutter_shows():
    icrf, delay_s = stars(40), np.random.default_rng(5).uniform(-0.03, 0.05, 40)
    acceleration = np.array([0.02, -0.01, 0.03])
    uv, moved = (np.array([pixels(one[None], late ** 2 / 2 * error)[0]
                           for one, late in zip(icrf, delay_s)])
                 for error in (np.zeros(3), acceleration))
    before, after = (corrected(icrf, one, delay_s=delay_s) for one in (uv, moved))
    measured = np.linalg.solve(before.information, after.vector - before.vector)
    np.testing.assert_allclose(
        measured, before.by_acceleration @ acceleration, rtol=0.02, atol=1e-9)


def test_without_a_rolling_shutter_the_attitude_is_all_that_is_measured():
    icrf = stars(20)
    found = corrected(icrf, pixels(icrf, TURN / 10))
    np.testing.assert_allclose(found.turn, TURN / 10, rtol=0.01)
    np.testing.assert_allclose(found.turn_covariance, np.linalg.inv(found.information))
    assert found.information.shape == (3, 3) and not found.by_acceleration.any()


def test_tracks_move_with_the_body():
    icrf, now = stars(5), state()
    track, covariance = on_image(CAMERA.lens, icrf, now)
    np.testing.assert_allclose(track[:, ::2], pixels(icrf, np.zeros(3)), atol=1e-9)
    step_s = 1e-3
    after = pixels(icrf, now.rate * step_s)
    before = pixels(icrf, -now.rate * step_s)
    np.testing.assert_allclose(track[:, 1::2], (after - before) / (2 * step_s), rtol=1e-4)
    flow = np.stack([(pixels(icrf, turn) - pixels(icrf, -turn)) / 2e-5
                     for turn in 1e-5 * np.eye(3)], -1)
    effect = np.zeros((5, 4, 6))
    effect[:, ::2, :3], effect[:, 1::2, 3:] = flow, flow
    np.testing.assert_allclose(
        covariance, effect @ now.covariance[:6, :6] @ np.swapaxes(effect, 1, 2), rtol=1e-6,
        atol=1e-9)
