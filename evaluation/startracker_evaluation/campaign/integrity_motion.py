# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Is a covariance true whatever moves? Star lists whose places are the light of an exposure."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, mean_attitude, multiply, quaternion_from_rotation_vector,
    random_attitude, rotate)
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.tools.datasheet.tally import (
    CAMERA, EPOCH_YEAR, START_NS, Tally, tally_of_frame, tally_of_other_times)

MAGNITUDE_LIMIT = 6.5
SIGMA_PX = 0.01
"""Error of a centroid per axis, small enough to show errors of the motion."""

FRAMES = 300
AT_S = -0.2, 0.2
"""Times after a frame at which at() is compared."""

_SAMPLE_S = 1e-3
_PARTS = 15  # of an exposure
_LATE_EVERY = 20
_ITERATIONS = 4  # in which the time of a star's row is found
LINE_TIME_S = 80e-6  # 82 ms from the first row to the last


@dataclass(frozen=True)
class MotionCondition:
    """
    A motion other than a steady turn, of frames step_s apart and exposed for exposure_s.

    kind is a key of MOTIONS, with its size and period_s. Unless timed, the lists do not have the
    exposure. stamp_s is the error of the stamps, 1 sigma; line_time_s the delay of each row of a
    rolling shutter, whose middle row is exposed at the stamp, and line_time_error what the lists
    have it wrong by, as a share. Of twenty frames late_frames in a row show the sky of the frame
    before. The camera sees stars to magnitude_limit. needed_percent of the frames that follow the
    two of a start must have an attitude.
    """

    kind: str
    size_deg: float
    period_s: float
    exposure_s: float = 0.0
    timed: bool = True
    step_s: float = 0.1
    stamp_s: float = 0.0
    line_time_s: float = 0.0
    line_time_error: float = 0.0
    late_frames: int = 0
    steady_deg_s: float = 0.02
    camera: Camera = CAMERA
    magnitude_limit: float = MAGNITUDE_LIMIT
    needed_percent: float = 99.0


def _sway(size: float, period_s: float, time_s: np.ndarray, rng: np.random.Generator
          ) -> np.ndarray:
    w = 2 * np.pi / period_s
    return size * w * np.cos(w * time_s + rng.uniform(0, 2 * np.pi))


def _steps(size: float, period_s: float, time_s: np.ndarray, rng: np.random.Generator
           ) -> np.ndarray:
    each = (time_s / period_s + rng.random()).astype(int)
    return rng.uniform(-size, size, each[-1] + 1)[each]


def _ramps(size: float, period_s: float, time_s: np.ndarray, rng: np.random.Generator
           ) -> np.ndarray:
    phase = time_s / period_s + rng.random()
    return size * period_s * (np.abs(phase % 1 - 0.5) - 0.25)


def _torques(size: float, period_s: float, time_s: np.ndarray, rng: np.random.Generator
             ) -> np.ndarray:
    # An acceleration of this standard deviation and time constant, an Ornstein-Uhlenbeck process.
    fade = np.exp(-_SAMPLE_S / period_s)
    rate, acceleration, rates = 0.0, size * rng.standard_normal(), np.empty(len(time_s))
    for k, noise in enumerate(rng.standard_normal(len(time_s)) * size * np.sqrt(1 - fade ** 2)):
        rates[k] = rate
        rate += acceleration * _SAMPLE_S
        acceleration = fade * acceleration + noise
    return rates


MOTIONS: dict[str, Callable[[float, float, np.ndarray, np.random.Generator], np.ndarray]] = {
    'sway': _sway, 'steps': _steps, 'ramps': _ramps, 'torques': _torques}
"""
The rate about one axis at times, of a size and a period: deg of a sway, deg/s of steps of the
rate, deg/s^2 of ramps of the rate up and down and of random torques that last for a period.
"""

_STILL = MotionCondition('sway', 0.0, 1.0)
_SWAYS = ((1.0, 10.0), (0.2, 2.0), (0.05, 1.0), (0.002, 0.2), (0.01, 0.5), (5.0, 100.0),
          (5.0, 20.0))

_ROLLING = {
    'no sway': _STILL,
    'sway 0.2 deg, 2 s': MotionCondition('sway', 0.2, 2.0),
    'sway 0.05 deg, 1 s': MotionCondition('sway', 0.05, 1.0),
    'ramps of 0.5 deg/s^2, 4 s': MotionCondition('ramps', 0.5, 4.0),
    'torques of 0.2 deg/s^2, 2 s, exposed 0.02 s': MotionCondition('torques', 0.2, 2.0, 0.02),
    'steps of 0.05 deg/s each 3 s': MotionCondition('steps', 0.05, 3.0)}

_CAMERAS = {
    '512 px, 20 deg': (Camera.from_fov(512, 512, 20.0), 5.5),
    '2048 px, 6 deg': (Camera.from_fov(2048, 2048, 6.0), 8.0),
    '1280 x 960 px, 40 deg': (Camera.from_fov(1280, 960, 40.0), 5.0)}

_CONDITIONS = {
    'no sway': _STILL,
    'no sway, exposed 0.1 s': MotionCondition('sway', 0.0, 1.0, 0.1),
    **{f'sway {size:g} deg, {period:g} s': MotionCondition('sway', size, period)
       for size, period in _SWAYS},
    **{f'sway {size:g} deg, {period:g} s, exposed 0.1 s':
       MotionCondition('sway', size, period, 0.1) for size, period in _SWAYS},
    'sway 1 deg, 10 s, exposed 0.1 s, no exposure times':
        MotionCondition('sway', 1.0, 10.0, 0.1, timed=False),
    'sway 0.2 deg, 2 s, exposed 0.02 s, no exposure times':
        MotionCondition('sway', 0.2, 2.0, 0.02, timed=False),
    'sway 1 deg, 20 s, exposed 0.5 s, 2 Hz':
        MotionCondition('sway', 1.0, 20.0, 0.5, step_s=0.5),
    'steps of 0.5 deg/s each second': MotionCondition('steps', 0.5, 1.0),
    'steps of 0.05 deg/s each 3 s, exposed 0.1 s': MotionCondition('steps', 0.05, 3.0, 0.1),
    'ramps of 0.5 deg/s^2, 4 s, exposed 0.1 s': MotionCondition('ramps', 0.5, 4.0, 0.1),
    'ramps of 0.02 deg/s^2, 10 s, exposed 0.1 s': MotionCondition('ramps', 0.02, 10.0, 0.1),
    'torques of 0.2 deg/s^2, 2 s, exposed 0.1 s': MotionCondition('torques', 0.2, 2.0, 0.1),
    'torques of 0.01 deg/s^2, 1 s, exposed 0.1 s': MotionCondition('torques', 0.01, 1.0, 0.1),
    **{f'{name}, rolling shutter': replace(condition, line_time_s=LINE_TIME_S)
       for name, condition in _ROLLING.items()},
    **{f'sway 0.2 deg, 2 s, exposed 0.1 s, {name}': MotionCondition(
        'sway', 0.2, 2.0, 0.1, camera=camera, magnitude_limit=limit)
       for name, (camera, limit) in _CAMERAS.items()},
    **{f'three images in a row one frame late, {rate:g} deg/s': MotionCondition(
        'sway', 0.0, 1.0, late_frames=3, steady_deg_s=rate) for rate in (0.2, 1.0)},
    **{f'line time {100 * error:+g} %, {rate:g} deg/s': MotionCondition(
        'sway', 0.0, 1.0, line_time_s=LINE_TIME_S, line_time_error=error, steady_deg_s=rate,
        needed_percent=0.0) for error, rate in ((0.1, 0.2), (0.1, 1.0), (-0.1, 1.0))},
    'timestamp errors of 5 ms': MotionCondition('sway', 0.0, 1.0, stamp_s=5e-3),
}

MOTION_CONDITIONS = {f'list, {name}': condition for name, condition in _CONDITIONS.items()}
"""By names that those of images do not have."""


@cache
def star_tracker(camera: Camera = CAMERA, magnitude_limit: float = MAGNITUDE_LIMIT) -> StarTracker:
    """Return the star tracker of star lists, which are those of an observer at rest."""
    return StarTracker.with_options(camera, EPOCH_YEAR, StarTrackerOptions(
        identification=IdentificationOptions(magnitude_limit=magnitude_limit),
        tracker=TrackerOptions(magnitude_limit=magnitude_limit),
        aberration=AberrationOptions(aberration='none')))


@cache
def onboard_stars(camera: Camera = CAMERA, magnitude_limit: float = MAGNITUDE_LIMIT
                  ) -> OnboardCatalog:
    """Return the stars of the lists."""
    return onboard_catalog(load_catalog(), camera, EPOCH_YEAR, magnitude_limit)


def motion_runs(name: str, runs: int, seed: int, frames: int = FRAMES) -> Tally:
    """Return the tally of so many runs of a condition, with the seeds from seed on."""
    return sum((_run(MOTION_CONDITIONS[name], np.random.default_rng(seed + run), frames)
                for run in range(runs)), Tally())


def _run(condition: MotionCondition, rng: np.random.Generator, frames: int) -> Tally:
    tally, before = Tally(), TrackerState.LOST
    for index, (result, pointing, rate_rad_s) in enumerate(motion_frames(condition, rng, frames)):
        tally += tally_of_frame(result, before, pointing(0.0), rate_rad_s, due=index >= 2)
        tally += tally_of_other_times(
            result.attitude, {after_s: pointing(after_s) for after_s in AT_S})
        before = result.state
    return tally


def motion_frames(condition: MotionCondition, rng: np.random.Generator, frames: int
                  ) -> Iterator[tuple[FrameResult, Callable[[float], np.ndarray], np.ndarray]]:
    """
    Yield what the star tracker has of each list of one run, with the truth.

    That is the function that gives the mean pointing (4,) of an exposure so many seconds later,
    and the mean rate (3,) of this one.
    """
    camera, sky = condition.camera, (condition.camera, condition.magnitude_limit)
    pipeline = star_tracker(*sky)
    pipeline.reset()
    attitude = attitudes(condition, rng, frames)
    # From the first sample an exposure, or an error of a stamp, may reach back.
    begin_s = (condition.exposure_s + 6 * condition.stamp_s
               + condition.line_time_s * camera.height / 2 - min(AT_S))
    part_s = condition.exposure_s * ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5)
    exposure_s = (condition.exposure_s,) * 2 if condition.timed else (0.0, np.inf)
    for frame in range(frames):
        stamp_s = begin_s + frame * condition.step_s
        is_late = frame % _LATE_EVERY >= _LATE_EVERY - condition.late_frames
        behind_s = condition.step_s * is_late
        exposed_s = stamp_s - behind_s + rng.normal(0, condition.stamp_s) + part_s
        truth = attitude(np.array([stamp_s]))[0]
        seen, hip = star_list(onboard_stars(*sky), camera, truth, SIGMA_PX, rng, missing=0.05,
                              false=3, exposed=attitude(exposed_s))
        if condition.line_time_s:
            seen = by_rows(seen, hip, attitude, stamp_s, condition.line_time_s)
            seen = replace(seen, delay_s=seen.delay_s * (1 + condition.line_time_error))
        result = pipeline.process_centroids(START_NS + round(frame * condition.step_s * 1e9),
                                 replace(seen, exposure_s=exposure_s))
        half_s = max(condition.exposure_s, _SAMPLE_S) / 2
        begin, end = attitude(np.array([stamp_s - half_s, stamp_s + half_s]))
        yield (result, partial(_mean_pointing, attitude, stamp_s + part_s),
               attitude_error(end, begin) / (2 * half_s))


def _mean_pointing(attitude: Callable[[np.ndarray], np.ndarray], times_s: np.ndarray,
                   after_s: float) -> np.ndarray:
    """Return the mean attitude (4,) over times (K,), so many seconds later."""
    return mean_attitude(attitude(times_s + after_s))


def by_rows(seen: Centroids, hip: np.ndarray, attitude: Callable[[np.ndarray], np.ndarray],
             stamp_s: float, line_time_s: float) -> Centroids:
    """Return centroids as of a rolling shutter: each star where it is at the time of its row."""
    star = hip > 0
    direction = onboard_stars().direction[onboard_stars().index_of(hip[star])]
    at_stamp = CAMERA.project(rotate(conjugate(attitude(np.array([stamp_s]))[0]), direction))
    uv = seen.uv.copy()
    for _ in range(_ITERATIONS):
        delay_s = (uv[:, 1] - (CAMERA.height - 1) / 2) * line_time_s
        uv[star] = seen.uv[star] - at_stamp + [
            CAMERA.project(rotate(conjugate(q), one))
            for q, one in zip(attitude(stamp_s + delay_s[star]), direction)]
    return replace(seen, uv=uv, delay_s=delay_s)


def attitudes(condition: MotionCondition, rng: np.random.Generator, frames: int
              ) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that gives q_icrf_from_sensor (K, 4) at times (K,)."""
    length_s = (frames + 1) * condition.step_s + 2 * condition.exposure_s + 1.0 + 2 * max(AT_S)
    time_s = np.arange(0, length_s, _SAMPLE_S)
    rate = np.radians(MOTIONS[condition.kind](
        condition.size_deg, condition.period_s, time_s, rng))
    angle = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * _SAMPLE_S)])
    axis, other = rng.standard_normal((2, 3))
    axis, other = axis / np.linalg.norm(axis), other / np.linalg.norm(other)
    steady, start = np.radians(condition.steady_deg_s) * other, random_attitude(rng)

    def at(times_s: np.ndarray) -> np.ndarray:
        return np.array([multiply(start, multiply(
            quaternion_from_rotation_vector(steady * now_s),
            quaternion_from_rotation_vector(axis * turned))) for now_s, turned in zip(
                times_s, np.interp(times_s, time_s, angle))])
    return at
