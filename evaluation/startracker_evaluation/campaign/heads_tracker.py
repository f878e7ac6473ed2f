# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of the real tracker as measurements of a fusion: independence and covariance."""

import numpy as np
from startracker_evaluation.campaign.integrity import CONDITIONS, run_of
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.tools.figures.rows import Row

_SETTLED = 10  # frames after a start
_EXPOSURE_S = (0.0, 0.0)  # an unknown one would be a doubt in the covariance of a frame

TRACKER_CONDITIONS = ('steady turn', 'slews to 1 deg/s', 'mirrored image',
                      'focal length off by 1 %')
"""Of the integrity campaign; the last two must give a fusion nothing."""


def tracker_runs(condition: str, runs: int, seed: int) -> np.ndarray:
    """
    Return sums over so many runs, (1, 9).

    Frames, frames with frame_attitude, the sum of its NEES and of its squared errors in arcsec^2
    (3); pairs of frames in a row, and the sum of the products of their normalised errors of
    frame_attitude (1) and of tracked_attitude (1), means of the three axes.
    """
    rng, sums = np.random.default_rng(seed), np.zeros(9)
    for _ in range(runs):
        before: tuple[np.ndarray, np.ndarray] | None = None
        for index, (pipeline, frame, truth, _) in enumerate(run_of(
                    CONDITIONS[condition], rng, _EXPOSURE_S)):
            measured = pipeline.tracker.frame_attitude
            sums[0] += 1
            if measured is None or frame.tracked is None or index < _SETTLED:
                before = None
                continue
            error = attitude_error(measured.quaternion, truth)
            tracked = frame.tracked.attitude
            both = (_whitened(error, measured.covariance_sensor), _whitened(
                attitude_error(tracked.quaternion, truth), tracked.covariance_sensor))
            sums[1:3] += 1, both[0] @ both[0]
            sums[3:6] += np.square(error / ARCSEC)
            if before is not None:
                sums[6:9] += 1, both[0] @ before[0] / 3, both[1] @ before[1] / 3
            before = both
    return sums[None]


def _whitened(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.linalg.cholesky(covariance), error)


def tracker_rows(condition: str, rows: np.ndarray) -> list[Row]:
    """Return the rows of one condition out of sums (parts, 9)."""
    measured, nees, x2, y2, z2, pairs, product, tracked_product = rows.sum(axis=0)[1:]
    if condition in ('mirrored image', 'focal length off by 1 %'):
        return [Row(f'tracker, {condition}: frames for a fusion', measured, 'frames', exactly=0)]
    correlation = product / pairs
    return [
        Row(f'tracker, {condition}: NEES of frame_attitude', nees / measured, '', least=2.7,
            most=3.3),
        Row(f'tracker, {condition}: correlation of its frames in a row', correlation, '',
            '<= 0.05', abs(correlation) <= 0.05),
        Row(f'tracker, {condition}: the same of tracked_attitude', tracked_product / pairs, ''),
        Row(f'tracker, {condition}: error across the boresight',
            float(np.sqrt((x2 + y2) / 2 / measured)), 'arcsec'),
        Row(f'tracker, {condition}: error in roll', float(np.sqrt(z2 / measured)), 'arcsec')]
