# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One filter for all stars: slews, dark images, right and wrong gyros."""

from dataclasses import dataclass, field, replace

from chi_square import check_mean
import numpy as np
import pytest
from scipy.stats import chi2
from star_motion import CAMERA, errors_of, Motion, sky, START_NS, STEP_NS
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter
from startracker_ros.tools.figures.correctness import nees_of

ONBOARD = sky()
DEG_H = np.radians(1 / 3600)
PER_FRAME = 10
GYRO = GyroErrorOptions(gyro_drift_deg_h=3.0, gyro_noise_deg_sqrt_h=0.15)


@dataclass
class Turns(Motion):
    """A camera whose body rate (deg/s about x, y, z) is given every 10 ms, with a gyro."""

    rates: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    drift_deg_h: float = 3.0

    def __post_init__(self):
        super().__post_init__()
        self.turns = [self.q_start]
        for rate in np.radians(self.rates):
            self.turns.append(multiply(self.turns[-1], quaternion_from_rotation_vector(
                rate * STEP_NS * 1e-9 / PER_FRAME)))
        self.drift = self.rng.normal(0, self.drift_deg_h * DEG_H, 3)

    @property
    def frames(self):
        return len(self.rates) // PER_FRAME

    def q(self, frame):
        return self.turns[round(frame * PER_FRAME)]

    def gyro(self, frame):
        """Yield the stamps and measured rates of the time before a frame."""
        dt_s = STEP_NS * 1e-9 / PER_FRAME
        for k in range(PER_FRAME * (frame - 1), PER_FRAME * frame):
            noise = self.rng.normal(0, np.radians(0.15 / 60) / np.sqrt(dt_s), 3)
            yield (START_NS + (k + 1) * STEP_NS // PER_FRAME,
                   np.radians(self.rates[k]) + self.drift + noise)


def frames_of(motion, *, gyro=None, dark=(), **options):
    """
    Run a tracker over a motion; yield the frame and the tracker once it tracks.

    gyro returns the measured rate of a true one; frames in dark have no stars.
    """
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(**options), GYRO)
    started = False
    for k in range(motion.frames):
        if gyro is not None and k > 0:
            for stamp_ns, rate in motion.gyro(k):
                tracker.add_rate(stamp_ns, gyro(rate))
        stamp_ns, centroids, hip = motion.frame(k)
        tracker.update(stamp_ns, Centroids.empty() if k in dark else centroids)
        if not started:
            tracker.identified(stamp_ns, centroids, hip)
            started = tracker.state is TrackerState.TRACKING
        else:
            yield k, tracker


def true(rate):
    return rate


def squared(tracker, motion, k):
    """Return the normalised squared error of the tracker's attitude."""
    attitude = tracker.attitude.attitude
    error = attitude_error(attitude.quaternion, motion.q(k))
    return error @ np.linalg.solve(attitude.covariance_sensor, error)


def wrong(tracker, motion, k):
    """Return whether the attitude is off by more than 5 sigma on any axis."""
    attitude = tracker.attitude.attitude
    error = attitude_error(attitude.quaternion, motion.q(k))
    return np.any(np.abs(error) > WRONG_SIGMAS * np.sqrt(np.diag(attitude.covariance_sensor)))


def slew(axis, peak_deg_s, acceleration_deg_s2, seconds):
    """Rest, a ramp up, a turn, a ramp down, rest."""
    time_s = np.arange(0, seconds, STEP_NS * 1e-9 / PER_FRAME)
    ramp = acceleration_deg_s2 * np.minimum(time_s - 2, seconds - 2 - time_s)
    return np.clip(ramp, 0, peak_deg_s)[:, None] * np.array(axis, float)


@pytest.mark.parametrize('axis', [(0, 1, 0), (0, 0, 1), (0.6, 0, 0.8)])
@pytest.mark.parametrize('peak_deg_s, acceleration_deg_s2, gyro', [
    (1.0, 0.05, None), (1.0, 0.5, None), (3.0, 0.5, true), (3.0, 5.0, true)])
def test_slews_are_tracked(axis, peak_deg_s, acceleration_deg_s2, gyro):
    motion = Turns(ONBOARD, rates=slew(axis, peak_deg_s, acceleration_deg_s2, 20.0),
                   false_points=5, missed=0.05)
    with_attitude = 0
    for k, tracker in frames_of(motion, gyro=gyro):
        assert tracker.state is TrackerState.TRACKING, (k, tracker.reason)
        if tracker.attitude is not None:
            with_attitude += 1
            assert not wrong(tracker, motion, k)
    assert with_attitude >= 0.99 * (motion.frames - 2)
    assert not tracker.gyro_trouble


@pytest.mark.parametrize('gyro, rate_deg_s', [(true, 0.3), (None, 0.06)])
def test_two_dark_seconds_are_bridged(gyro, rate_deg_s):
    rates = np.tile([0.0, rate_deg_s, rate_deg_s / 3], (900, 1))
    motion = Turns(ONBOARD, rates=rates, seed=1)
    dark = range(40, 60)
    for k, tracker in frames_of(motion, gyro=gyro, dark=dark):
        assert tracker.state is TrackerState.TRACKING
        assert (tracker.attitude is None) == (k in dark), k
        if k not in dark:
            assert squared(tracker, motion, k) < 25


def test_a_gyro_bridges_a_slew_in_the_dark():
    motion = Turns(ONBOARD, rates=slew((0, 1, 0), 3.0, 5.0, 9.0))
    dark = range(19, 39)
    for k, tracker in frames_of(motion, gyro=true, dark=dark):
        assert (tracker.attitude is None) == (k in dark), k


WRONG_GYROS = {
    'degrees': np.degrees,
    'axes': lambda rate: rate[[1, 2, 0]],
    'sign': lambda rate: -rate,
    'stuck': lambda rate: np.radians([0.5, 0.0, 0.0]),
    'scale': lambda rate: 1.2 * rate,
    'turned by 3 deg': lambda rate: rate + np.cross(np.radians([0.0, 0.0, 3.0]), rate),
}


@pytest.mark.parametrize('error', WRONG_GYROS)
def test_a_wrong_gyro_is_reported_and_does_no_harm(error):
    rates = slew((0.2, 1, 0.3), 0.5, 0.1, 20.0)
    motion = Turns(ONBOARD, rates=rates, false_points=5)
    troubled = 0
    for k, tracker in frames_of(motion, gyro=WRONG_GYROS[error]):
        assert tracker.state is TrackerState.TRACKING, (k, tracker.reason)
        troubled += 'rad/s' in tracker.gyro_trouble
        if tracker.attitude is not None:
            assert not wrong(tracker, motion, k)
    assert troubled > 60


def test_a_gyro_follows_a_body_that_changes_its_rate():
    """A filter of a steady turn contradicted every second frame, and its rate lagged behind."""
    squares, of_rate = [], []
    for seed in range(3):
        motion = Turns(ONBOARD, rates=slew((0.6, 0, 0.8), 3.0, 0.5, 20.0), seed=seed)
        for k, tracker in frames_of(motion, gyro=true):
            if 25 < k < 80:
                tracked, rate = tracker.attitude, np.radians(motion.rates[PER_FRAME * k - 1])
                error = attitude_error(tracked.attitude.quaternion, motion.q(k))
                squares.append(error[2] ** 2 / tracker.frame_attitude.covariance_sensor[2, 2])
                of_rate.extend(nees_of((tracked.rate_rad_s - rate)[None],
                                       tracked.rate_covariance[None]))
    assert np.mean(squares) < 0.4
    assert np.mean(of_rate) < 4


def test_after_a_jump_its_rate_is_known_as_well_as_its_covariance_says():
    """The least acceleration within the gate left a rate that was off by nine sigma."""
    squares, rng = [], np.random.default_rng(3)
    for seed in range(20):
        rates = np.repeat([[0.0, 0.0, 0.1], [0.0, 0.0, 0.1 + rng.uniform(0.1, 0.2)]], 100, axis=0)
        for k, tracker in frames_of(Turns(ONBOARD, rates=rates, seed=seed)):
            if 12 < k < 15:
                error = tracker.attitude.rate_rad_s[2] - np.radians(rates[-1, 2])
                squares.append(error ** 2 / tracker.attitude.rate_covariance[2, 2])
    assert np.mean(squares) < 2


@pytest.mark.parametrize('roll_deg_s', [0.2, 0.4])
def test_the_covariance_says_that_a_rate_has_just_changed(roll_deg_s):
    """By the frame itself the attitude alone may have been off: the rate stayed what it was."""
    squares = []
    for seed in range(10):
        rates = np.repeat([[0.0, 0.0, 0.1], [0.0, 0.0, 0.1 + roll_deg_s]], 100, axis=0)
        for k, tracker in frames_of(Turns(ONBOARD, rates=rates, seed=seed)):
            if 10 < k < 15:
                error = tracker.attitude.rate_rad_s[2] - np.radians(rates[-1, 2])
                squares.append(error ** 2 / tracker.attitude.rate_covariance[2, 2])
    assert max(squares) < WRONG_SIGMAS ** 2 and np.mean(squares) < 2


def test_a_gyro_that_stops_is_not_needed():
    rates = np.tile([0.0, 0.3, 0.0], (1000, 1))
    motion = Turns(ONBOARD, rates=rates)
    tracker = None
    for k, tracker in frames_of(motion, gyro=true):
        if k == 50:
            tracker.add_rate = lambda stamp_ns, rate: True
        assert tracker.attitude is not None and not wrong(tracker, motion, k)
    np.testing.assert_allclose(np.degrees(tracker.attitude.rate_rad_s), [0, 0.3, 0], atol=0.01)
    assert not tracker.gyro_trouble


def random_turns(rng, seconds, acceleration_deg_s2):
    """Return rates (N, 3) with an acceleration that is constant over a frame, as assumed."""
    frames = round(seconds / (STEP_NS * 1e-9))
    acceleration = rng.normal(0, acceleration_deg_s2, (frames, 3)).repeat(PER_FRAME, axis=0)
    return np.cumsum(acceleration, axis=0) * STEP_NS * 1e-9 / PER_FRAME + [0.0, 0.1, 0.05]


@pytest.mark.slow
@pytest.mark.parametrize('gyro', [None, true])
def test_the_covariance_is_consistent(gyro):
    """The last of 30 frames of 60 runs, with the motion and the errors that are assumed."""
    total, rate_total, runs = 0.0, 0.0, 60
    for seed in range(runs):
        rng = np.random.default_rng(1000 + seed)
        motion = Turns(ONBOARD, rates=random_turns(rng, 3.0, 0.005), seed=seed, missed=0.05,
                       pointing_deg=(rng.uniform(60, 120), rng.uniform(-20, 40), 0.0))
        *_, (_, tracker) = frames_of(motion, gyro=gyro)
        total += squared(tracker, motion, motion.frames - 1)
        tracked = tracker.attitude
        offset = tracked.rate_rad_s - np.radians(motion.rates[PER_FRAME * (motion.frames - 1) - 1])
        rate_total += offset @ np.linalg.solve(tracked.rate_covariance, offset)
    low, high = chi2.ppf([0.025, 0.975], 3 * runs)
    assert low < total < high
    assert rate_total < high


@pytest.mark.slow
def test_better_than_a_filter_for_each_star():
    rng = np.random.default_rng(5)
    rates = random_turns(rng, 20.0, 0.005)
    rms = {}
    for model, gyro in (('attitude', None), ('attitude', true), ('constant_velocity', None)):
        motion = Turns(ONBOARD, rates=rates, false_points=5, missed=0.05, seed=1)
        errors = [attitude_error(tracker.attitude.attitude.quaternion, motion.q(k))
                  for k, tracker in frames_of(motion, gyro=gyro, model=model)]
        rms[model, gyro] = np.sqrt(np.mean(np.square(errors))) / ARCSEC
    assert rms['attitude', true] < rms['attitude', None] < rms['constant_velocity', None]


@pytest.mark.parametrize('model', TrackerOptions.table()[0].choices)
def test_a_tracker_reports_before_its_first_start(model):
    """As the node does when it receives camera_info."""
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(model=model), GYRO)
    assert tracker.stamp_sigma_s == 0.0


def flown(motion, frames=80):
    """Return errors (F, 3) and covariances (F, 3, 3) of a tracker of a nominal camera."""
    return errors_of(TrackFilter(CAMERA, ONBOARD, TrackerOptions()), (
        (*motion.frame(frame), motion.q(frame)) for frame in range(frames)))


def published_sigma(stated, **options):
    """Return the sigma (3,) of a tracker of stars with errors stated so many times too large."""
    motion = Motion(ONBOARD, (0.1, 0.25, 0.1), sigma_per_magnitude=0.05)
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(**options))
    _, covariances = errors_of(tracker, (
        (stamp_ns, replace(seen, sigma_px=stated * seen.sigma_px,
                           covariance=stated ** 2 * seen.covariance), hip, motion.q(frame))
        for frame in range(80) for stamp_ns, seen, hip in [motion.frame(frame)]))
    return np.sqrt(np.mean([np.diag(covariance) for covariance in covariances[50:]], axis=0))


def test_errors_that_are_stated_too_large_are_estimated():
    """As of stars that are not Gaussians."""
    true_sigma = published_sigma(1.0)
    assert published_sigma(1.6) == pytest.approx(true_sigma, rel=0.1)
    assert (published_sigma(4.0) > 1.4 * true_sigma).all()
    # The least error that is assumed stays as it is.
    assert (published_sigma(1.0, sigma_floor_px=0.16) > 1.3 * true_sigma).all()


def test_a_wrong_focal_length_is_taken_out():
    runs = {ratio: [flown(Motion(ONBOARD, (0.1, 0.25, 0.1), seed=seed,
                                 camera=CAMERA.with_focal_ratio(ratio))) for seed in range(6)]
            for ratio in (1.0, 1.001)}
    rms = {ratio: np.sqrt(np.mean([np.mean(errors[20:] ** 2, axis=0) for errors, _ in each], 0))
           for ratio, each in runs.items()}
    assert (rms[1.001] < 1.3 * rms[1.0]).all()
    check_mean(3, *[nees_of(*run)[20:] for run in runs[1.001]], inflation=1.5)
    # The first frame, by a lens of which nothing is known, says so.
    assert (nees_of(*(np.concatenate([run[k][:20] for run in runs[1.001]]) for k in (0, 1)))
            < chi2.ppf(1 - 1e-6, 3)).all()
