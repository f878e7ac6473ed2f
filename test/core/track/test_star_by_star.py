# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of the star-by-star models: solver, confirmation by SNA, a roll that a gyro measures."""

from dataclasses import dataclass

from native_bank import rolled
import numpy as np
import pytest
from star_motion import CAMERA, Motion, sky, STEP_NS
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.stages.parameters import options_of_keywords, ParameterError
from startracker_ros.core.track.motion_models import constant_velocity
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter

ONBOARD = sky()


@dataclass
class Jittering(Motion):
    """A steady turn with a roll rate that is new, within +-jitter_deg_s, every ten frames."""

    jitter_deg_s: float = 0.5

    def __post_init__(self):
        super().__post_init__()
        self.roll_rad_s = np.radians(self.jitter_deg_s) * np.random.default_rng(
            self.seed + 100).uniform(-1, 1, 100)

    def q(self, frame):
        block, within = divmod(frame, 10)
        angle = STEP_NS * 1e-9 * (
            10 * self.roll_rad_s[:int(block)].sum() + within * self.roll_rad_s[int(block)])
        return multiply(super().q(frame), quaternion_from_rotation_vector([0.0, 0.0, angle]))

    def rate(self, frame):
        """Return the mean body rate (3,) since the frame before."""
        turn = attitude_error(self.q(frame), self.q(frame - 1))
        return turn / (STEP_NS * 1e-9)


def flown(motion, frames, gyro=False, **options):
    """Return a tracker after some frames, and its errors (F, 3) in arcsec from the third on."""
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(**options))
    errors = []
    for k in range(frames):
        stamp_ns, centroids, hip = motion.frame(k)
        if gyro and k:
            tracker.add_rate(stamp_ns, motion.rate(k))
        tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, hip)
        elif tracker.attitude is not None and k > 2:
            errors.append(attitude_error(tracker.attitude.attitude.quaternion, motion.q(k)))
    return tracker, np.array(errors) / ARCSEC


@pytest.mark.parametrize('given', [
    {'solver': 'triad'}, {'model': 'sna', 'association': 'diffuse'}, {'sna_confirmation': True},
    {'model': 'sna', 'roll_by_gyro': True}])
def test_options_without_effect_are_refused(given):
    with pytest.raises(ValueError, match='has no effect with model = .* it is an option of'):
        TrackerOptions(**given)


def test_options_of_filters_are_named_where_there_is_none():
    assert TrackerOptions(model='sna', gate_probability=0.99).ignored == ['gate_probability']
    assert not TrackerOptions(model='constant_velocity', gate_probability=0.99).ignored
    assert not TrackerOptions(model='constant_velocity').reads_gyro


def test_a_solver_of_the_library_is_that_of_the_tracker():
    with pytest.raises(ParameterError, match='has no effect with model'):
        options_of_keywords({'solver': 'triad'})
    with pytest.raises(ParameterError, match='set star_tracker.solver'):
        options_of_keywords({'attitude_estimator': {'solver': 'triad'}})
    chosen = options_of_keywords({'solver': 'triad', 'model': 'coordinated_turn'})
    assert chosen.tracker.solver == chosen.validation.solver == 'triad'


@pytest.mark.parametrize('model', ['constant_velocity', 'coordinated_turn', 'sna'])
def test_the_attitude_is_that_of_the_solver_and_the_same_stars(model):
    motion = Motion(ONBOARD, (0.0, 0.1, 0.05), false_points=10)
    tracker, _ = flown(motion, 20, model=model, solver='triad')
    stamp_ns, centroids, _ = motion.frame(20)
    tracks = tracker.update(stamp_ns, centroids)
    used = tracks.usable
    directions = ONBOARD.direction[ONBOARD.index_of(tracks.hip[used])]
    sigma_rad = tracks.position_sigma_px[used] * CAMERA.pixel_rad
    by_triad, by_quest = (estimate_attitude(
        CAMERA.unproject(tracks.uv[used]), directions, sigma_rad, solver)
        for solver in ('triad', 'quest'))
    found = tracker.attitude.attitude
    assert np.linalg.norm(attitude_error(found.quaternion, by_triad.quaternion)) < 1e-12
    assert np.linalg.norm(attitude_error(found.quaternion, by_quest.quaternion)) > 1e-7
    error = attitude_error(found.quaternion, motion.q(20))
    assert error @ np.linalg.solve(found.covariance_sensor, error) < 25


@pytest.mark.parametrize('model', ['constant_velocity', 'coordinated_turn'])
def test_a_measured_roll_is_not_noise(model):
    rms = {}
    for measured in (True, False):
        motion = Jittering(ONBOARD, (0.0, 0.06, 0.0), false_points=20)
        # What is not measured has to be noise: the changes of the roll rate.
        roll = {'roll_by_gyro': True} if measured else {'roll_acceleration_deg_s2': 2.0}
        tracker, errors = flown(motion, 200, True, model=model, solver='triad', **roll)
        assert tracker.state is TrackerState.TRACKING and len(errors) > 190
        assert tracker.gyro_condition == ('used' if measured else 'unused')
        rms[measured] = np.sqrt(np.mean(errors ** 2, axis=0))
    assert (rms[True] < rms[False]).all() and rms[True][2] < 0.7 * rms[False][2]
    sigma_arcsec = np.sqrt(np.diag(flown(
        motion, 100, True, model=model, solver='triad', roll_by_gyro=True
    )[0].attitude.attitude.covariance_sensor)) / ARCSEC
    assert (rms[True] < 1.5 * sigma_arcsec).all()


def test_a_roll_without_a_gyro_is_named():
    motion = Motion(ONBOARD, (0.0, 0.06, 0.0))
    tracker, errors = flown(motion, 20, model='constant_velocity', roll_by_gyro=True)
    assert len(errors) and 'no rates of imu' in tracker.gyro_trouble


class GyroInDegrees(Jittering):
    """The same with a gyro that reports deg/s."""

    def rate(self, frame):
        return np.degrees(super().rate(frame))


def test_a_wrong_gyro_is_named_and_gives_no_wrong_attitude():
    motion = GyroInDegrees(ONBOARD, (0.0, 0.06, 0.0))
    # The first change of the rate.
    tracker, _ = flown(motion, 12, True, model='constant_velocity', roll_by_gyro=True)
    assert 'is it in rad/s' in tracker.gyro_trouble and tracker.attitude is None
    _, errors = flown(motion, 40, True, model='constant_velocity', roll_by_gyro=True)
    assert (np.abs(errors) < 120).all()


def test_a_rolled_state_is_that_of_the_turned_camera():
    camera = Camera(1024, 1024, 4000.0, 5000.0, 500.0, 520.0)
    before, after, dt_s = 0.02, -0.3, 0.5
    star, across = np.array([0.05, -0.03, 1.0]), np.array([0.0004, 0.0007, 0.0])
    centre = np.array([camera.cx, 0.0, camera.cy, 0.0])

    def state(direction, velocity, rate):
        """Return the state of a star on the plane z = 1, under a roll of the camera."""
        flow = image_jacobian(camera, direction[None] / np.linalg.norm(direction))[0]
        image_velocity = [camera.fx, camera.fy] * velocity[:2] + flow @ [0.0, 0.0, rate]
        return np.ravel(np.column_stack([camera.project(direction[None])[0], image_velocity]))
    start = state(star, across, before)
    turn = conjugate(quaternion_from_rotation_vector([0.0, 0.0, after * dt_s]))
    end = state(rotate(turn, star + across * dt_s), rotate(turn, across), after)
    transition = (rolled(camera, after, dt_s) @ constant_velocity(dt_s, (1.0, 1.0))[0]
                  @ rolled(camera, -before, 0.0))
    np.testing.assert_allclose(transition @ (start - centre) + centre, end, rtol=0, atol=1e-9)


def test_of_two_centroids_near_a_star_the_one_confirmed_by_sna_is_used():
    probability = {}
    for confirmation in (True, False):
        motion = Motion(ONBOARD)
        tracker, _ = flown(motion, 20, model='constant_velocity', sna_confirmation=confirmation)
        stamp_ns, centroids, hip = motion.frame(20)
        # A false point in the place of the faintest star, as far from another star as its own.
        star = 4
        centroids.uv[-1] = 2 * motion.place(20, hip[[star]])[0] - centroids.uv[star]
        tracks = tracker.update(stamp_ns, centroids)
        probability[confirmation], = tracks.association_probability[tracks.hip == hip[star]]
    assert probability[False] < 0.9 < 0.97 < probability[True]
