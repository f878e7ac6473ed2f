# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitudes between the frames of a rolling shutter, at more times than there are frames.

The bound of each is that of Cramer and Rao for the stars of one frame, each at the time of its own
row: with the error of a centroid and D = [J, d J], J the image jacobian and d the delay of the
star, attitude and rate have the information sum D^T D / sigma^2.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from startracker_evaluation.campaign.integrity import NEES_BOUNDS
from startracker_evaluation.campaign.integrity_motion import (
    attitudes, by_rows, LINE_TIME_S, MAGNITUDE_LIMIT, MotionCondition, onboard_stars, star_tracker)
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.io.table import Result
from startracker_ros.tools.datasheet.tally import CAMERA, START_NS
from startracker_ros.tools.figures.correctness import count_wrong, WRONG_SHARE, WRONG_TEXT
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.parallel import joined, parallel_trials

SIGMA_PX = 0.1
FRAMES, SETTLED = 120, 20
SUB_FRAMES = 16
_STEP_S = 0.1
_PIECE = 2

MOTIONS = {
    'turn at 5 deg/s': MotionCondition('sway', 0.0, 1.0, steady_deg_s=5.0),
    'turn at 5 deg/s, ramps of 0.5 deg/s^2': MotionCondition(
        'ramps', 0.5, 4.0, steady_deg_s=5.0),
    'sway 0.2 deg, 2 s': MotionCondition('sway', 0.2, 2.0),
    'sway 1 deg, 10 s': MotionCondition('sway', 1.0, 10.0)}


@dataclass(frozen=True)
class _Sums:
    """Of frames due, and of attitudes at the times of sub-frames: sums of normalised squares."""

    due: int = 0
    published: int = 0
    attitudes: int = 0
    wrong: int = 0
    by_covariance: float = 0.0
    by_bound: float = 0.0
    by_bound_at_known_rate: float = 0.0


def sub_frame_runs(motion: str, runs: int, seed: int) -> _Sums:
    """Return the sums of so many runs, with the seeds from seed on."""
    return joined([sums for run in range(runs) for sums in _frames(
        MOTIONS[motion], np.random.default_rng(seed + run))])


def _frames(condition: MotionCondition, rng: np.random.Generator) -> Iterator[_Sums]:
    """Yield what each settled frame of a run adds, and each of its sub-frames."""
    pipeline = star_tracker()
    pipeline.reset()
    attitude = attitudes(condition, rng, FRAMES)
    offsets_s = ((np.arange(SUB_FRAMES) + 0.5) / SUB_FRAMES - 0.5) * _STEP_S
    for frame in range(FRAMES):
        time_s, stamp_ns = (frame + 1) * _STEP_S, START_NS + round(frame * _STEP_S * 1e9)
        seen, hip = star_list(onboard_stars(), CAMERA, attitude(np.array([time_s]))[0], SIGMA_PX,
                              rng, missing=0.05)
        seen = replace(by_rows(seen, hip, attitude, time_s, LINE_TIME_S), exposure_s=(0.0, 0.0))
        published = pipeline.process_centroids(stamp_ns, seen).attitude
        if frame < SETTLED:
            continue
        yield _Sums(due=1, published=int(published is not None))
        if published is None:
            continue
        information = _information(seen)
        for one, offset_s, truth in zip(published.sub_frames(SUB_FRAMES, round(_STEP_S * 1e9)),
                                        offsets_s, attitude(time_s + offsets_s)):
            error, P = attitude_error(one.quaternion, truth), one.covariance_sensor
            to_time = np.hstack([np.eye(3), offset_s * np.eye(3)])
            bound = to_time @ np.linalg.solve(information, to_time.T)
            yield _Sums(
                attitudes=1, wrong=count_wrong(error, np.sqrt(np.diag(P))).wrong,
                by_covariance=float(error @ np.linalg.solve(P, error)),
                by_bound=float(error @ np.linalg.solve(bound, error)),
                by_bound_at_known_rate=float(error @ information[:3, :3] @ error))


def _information(seen: Centroids) -> np.ndarray:
    """Return that (6, 6) of the stars of a frame about attitude and rate."""
    flow = image_jacobian(CAMERA, CAMERA.unproject(seen.uv))
    design = np.concatenate([flow, seen.delay_s[:, None, None] * flow], -1).reshape(-1, 6)
    return design.T @ design / SIGMA_PX ** 2


def _rows(motion: str, sums: _Sums) -> Iterator[Row]:
    count, (low, high) = sums.attitudes, NEES_BOUNDS
    yield Row(f'{motion}: published', 100 * sums.published / sums.due, '%', least=95)
    yield Row(f'{motion}: rate of attitudes', SUB_FRAMES / _STEP_S, 'Hz', least=150)
    yield Row(f'{motion}: NEES', sums.by_covariance / count, '', least=low, most=high)
    yield Row(f'{motion}: wrong', sums.wrong / count, 'share', most=WRONG_SHARE)
    yield Row(f'{motion}: error over the bound of a frame', np.sqrt(sums.by_bound / count / 3),
              'ratio', most=1.2)
    yield Row(f'{motion}: error over the bound of a frame at a known rate',
              np.sqrt(sums.by_bound_at_known_rate / count / 3), 'ratio')


def run_sub_frames_campaign(*, trials: int, seed: int, scheduler: str = '') -> Result:
    """Follow trials runs of each motion."""
    sums = parallel_trials(sub_frame_runs, [(motion,) for motion in MOTIONS], trials, _PIECE, seed,
                           title='sub-frames', scheduler=scheduler)
    rows = [row for motion, one in zip(MOTIONS, sums) for row in _rows(motion, one)]
    return Result('campaign sub-frames', rows, {
        'camera': f'1024 x 1024 px, 12 deg, {1 / _STEP_S:g} Hz, rolling shutter of '
                  f'{LINE_TIME_S * 1e6:g} us a row',
        'star lists': f'centroids of {SIGMA_PX:g} px, stars to V {MAGNITUDE_LIMIT:g}, 5 % missing;'
                      f' runs of {FRAMES} frames, of which {SETTLED} settle',
        'attitudes': f'{SUB_FRAMES} a frame by Attitude.at(), over the frame interval about its '
                     'stamp',
        'bound': 'of Cramer and Rao, of the stars of the frame alone at the times of their rows; '
                 'the rate is unknown, or known; the tracker knows the frames before',
        'wrong': WRONG_TEXT, 'trials': trials, 'seed': seed})
