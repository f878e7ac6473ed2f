# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Every check that decides whether a frame is used and an attitude is trusted: the one table.

The figures of each, its threshold and its limits, are those of the native core, where they stand
alone (native/src/integrity/checks.h); evidence, action and sentence stand here. docs/integrity.md
is this table, made by startracker_ros.ros.tables.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
import math
from string import Formatter
from typing import Any, Literal

from startracker_ros.core import native

Action = Literal['star not used', 'frame not used', 'rates not used', 'hint not used',
                 'next hypothesis', 'other stars', 'wider covariance', 'larger bound', 'restart',
                 'no attitude']


@dataclass(frozen=True)
class Check:
    """
    One check: the action follows where the evidence is beyond the threshold.

    diagnostic is the sentence that a user reads, with fields for its figures, or the `keys` of
    diagnostics that show it; empty where another hypothesis is tried. options are the parameters
    that are limits.
    """

    name: str
    evidence: str
    action: Action
    diagnostic: str
    options: str = ''

    @cached_property
    def _figures(self) -> Any:
        return native.checks()[self.name]

    @property
    def probability(self) -> float:
        """That of the threshold by chance; 0 where the evidence has no known distribution."""
        return float(self._figures['probability'])

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square of the threshold, 0 for none."""
        return int(self._figures['dof'])

    @property
    def threshold(self) -> float:
        """The chi-square that is exceeded with the probability."""
        return float(self._figures['threshold'])

    @property
    def sigmas(self) -> float:
        """The square root of the threshold."""
        return math.sqrt(self.threshold)

    @cached_property
    def limits(self) -> Mapping[str, float]:
        """Limits of figures without a known distribution, by names with their units."""
        return {native.text_at(one['name']): float(one['value'])
                for one in self._figures['limit'][:self._figures['limits']]}

    @property
    def frames(self) -> int:
        """The frames that the check looks at, in a row or the first; 0 for the one."""
        return int(self._figures['frames'])

    @property
    def reason(self) -> int:
        """The st_reason_code of the native core, 0 where it has none."""
        return int(self._figures['reason'])

    def sentence(self, figures: Sequence[float]) -> str:
        """Return the diagnostic with the figures of an st_reason."""
        fields = [(name, kind) for _, name, kind, _ in Formatter().parse(self.diagnostic)
                  if name is not None]
        if self.name in _FIELDS:
            return self.diagnostic.format(**_FIELDS[self.name](figures))
        # Numbers without a format are counts.
        return self.diagnostic.format(**{
            name: figure if kind else int(figure)
            for (name, kind), figure in zip(fields, figures)})


def rate_text(rate_rad_s: Sequence[float]) -> str:
    """Return a rate (3,) as text, in deg/s."""
    return ' '.join(f'{math.degrees(value):.4f}' for value in rate_rad_s)


_FIELDS: Mapping[str, Callable[[Sequence[float]], dict[str, Any]]] = {
    'FEW_STARS': lambda figures: {
        'count': int(figures[0]), 'limit': int(figures[1]),
        'kind': 'tracked' if figures[2] else 'identified'},
    'GYRO_DIFFERS': lambda figures: {
        'reported': rate_text(figures[:3]), 'stars': rate_text(figures[3:6])},
    'FILTER_COVARIANCE': lambda figures: {'variances': [float(one) for one in figures[:9]]},
    'COVARIANCE': lambda figures: {'variances': [float(one) for one in figures[:3]]}}
"""Figures of diagnostics with texts and lists."""


# --- frames, as they come ---
LATE_FRAME = Check(
    'LATE_FRAME', 'stamp at most back_s older than the last one, or equal',
    'frame not used', '`late_frames`')
TIME_JUMP = Check(
    'TIME_JUMP', 'stamp older by more: a simulation or recording has restarted', 'restart',
    'time jumped back by {back_s:.1f} s')
REPEATED_FRAME = Check(
    'REPEATED_FRAME',
    'positions equal those of the previous frame to the last digit, although the brightest star '
    'has moved before', 'frame not used',
    'the centroids are those of the frame before, with their noise')
UNUSABLE_CENTROID = Check(
    'UNUSABLE_CENTROID', 'position or sigma is not finite, or sigma not positive', 'star not used',
    '`rejected_centroids`')

# --- the start ---
MISFIT = Check(
    'MISFIT', 'rms residual of the identified stars', 'frame not used',
    '{stars} identified stars fit to {residual_px:.2g} px rms, max_residual_px is {limit:g}: '
    'calibrate the lens', options='max_residual_px')
SECOND_TOO_LATE = Check(
    'SECOND_TOO_LATE', 'time since the first identification', 'restart',
    'no second identification within {max_gap_s:g} s', options='max_gap_s')
START_RATE = Check(
    'START_RATE', 'rate between two identifications', 'restart',
    'two identifications {rate_deg_s:.3g} deg/s apart', options='max_rate_deg_s')
HINT = Check(
    'HINT', '1 sigma of attitude and rate of a hint, about any axis', 'hint not used', '`reason`')
HINT_DIFFERS = Check(
    'HINT_DIFFERS', 'identified attitude minus that of a hint or of earlier tracks',
    'hint not used', '`reason`')
HINT_FAILED = Check(
    'HINT_FAILED', 'good frames from a start by a hint to the loss of the stars', 'hint not used',
    '`reason`')
IDENTIFICATION_DIFFERS = Check(
    'IDENTIFICATION_DIFFERS',
    'identified attitude minus that of the tracks, and its rms residual over max_residual_px',
    'restart', 'an identification contradicts the tracks by {error_deg:.3g} deg')

# --- the filter ---
STAR_OUTLIER = Check(
    'STAR_OUTLIER', 'residual of a star over its sigma', 'star not used', '`residual_px`')
LIKELY_INNOVATION = Check(
    'LIKELY_INNOVATION',
    'innovation of the attitude by a hypothesis before the last one; the first likely one is used',
    'next hypothesis', '')
INNOVATION = Check(
    'INNOVATION', 'innovation of the attitude by the last hypothesis', 'frame not used',
    '`frames_since_fix`')
FEW_AGREE = Check(
    'FEW_AGREE',
    'stars that fit the corrected attitude, of those in the image, and their rms residual',
    'frame not used', '`stars_matched`', options='min_stars, max_residual_px')
BAD_FRAMES = Check(
    'BAD_FRAMES', 'frames in a row that are not used', 'restart',
    '{frames} bad frames: {stars} stars agreed in the last one, residual {residual_px:.2f} px',
    options='max_bad_frames')
STARS_ELSEWHERE = Check(
    'STARS_ELSEWHERE', 'identified frames in a row that are not used', 'restart',
    '{frames} bad frames, but {stars} stars identified')
NO_STARS = Check(
    'NO_STARS', 'time since the last frame that was used', 'restart', 'no stars for {gap_s:.1f} s',
    options='max_gap_s')
DIVERGED = Check(
    'DIVERGED', 'innovation by agreeing stars, in frames in a row', 'restart',
    'the filter has diverged: {frames} frames in a row with innovations beyond {sigmas:g} sigma, '
    'the last of {last:.0f}')
FILTER_COVARIANCE = Check(
    'FILTER_COVARIANCE', 'covariance of the filter is not finite, or not positive definite',
    'restart',
    'the covariance of the filter is not positive definite, its diagonal is {variances}')
SHEARED_STARS = Check(
    'SHEARED_STARS',
    'stars of a rolling shutter that a motion does not explain: exposed after a jump',
    'next hypothesis', '')
FAST_TURN = Check(
    'FAST_TURN',
    'motion of the stars in a frame over the image width, and distance of a possible centroid',
    'other stars', '`reason`')

# --- a gyro ---
GYRO_SILENT = Check('GYRO_SILENT', 'age of the newest rate', 'rates not used', '`gyro`')
GYRO_AT_RANGE = Check(
    'GYRO_AT_RANGE', 'rates at gyro_range_deg_s', 'rates not used',
    'imu reaches gyro_range_deg_s: its rates are not used while the true ones may be larger')
GYRO_DIFFERS = Check(
    'GYRO_DIFFERS', 'rotation by the rates minus that by the stars, in frames in a row',
    'rates not used',
    'imu reports {reported} deg/s about x, y, z, the stars {stars}: is it in rad/s, on the axes '
    'of the sensor, and gyro_drift_deg_h right?')
GYRO_BLIND = Check(
    'GYRO_BLIND', 'rates at gyro_range_deg_s in a frame of too few stars', 'restart',
    'imu reaches gyro_range_deg_s while there are no stars: the attitude is not known')
MOTION_ENDS = Check(
    'MOTION_ENDS', 'probability of the previous mode of motion, by the rates since then',
    'next hypothesis', '')

# --- errors that the stars show or do not exclude, in the error budget ---
JUMP_IN_FRAME = Check(
    'JUMP_IN_FRAME',
    'probability of a motion that starts within the frame, times the exposed share of the '
    'interval; at least that of a stamp error', 'wider covariance',
    '`error_budget.motion_arcsec`')
DISPLACED = Check(
    'DISPLACED', 'rate in the frames after a jump minus the rate before it, below the threshold',
    'wider covariance', '`error_budget.motion_arcsec`')
STAMP_ERRORS = Check(
    'STAMP_ERRORS',
    'variance of the stamps, by rotations along the rate that change sign, over that by the '
    'centroids: above `many` (`expected` after earlier stamp errors) plus `few` over the number '
    'of products, and `shaken` times the variance across the rate; at the start up to `first_s` '
    'unless excluded', 'wider covariance',
    '`error_budget.stamps_arcsec`, `stamp_sigma_ms`')
LENS_ERROR = Check(
    'LENS_ERROR',
    'mean product of the residuals of a star in successive frames; common scale of all stars',
    'wider covariance', '`error_budget.lens_arcsec`')
ERROR_SCALE = Check(
    'ERROR_SCALE',
    'median residual over that expected by sigma, of all stars and of the more precise half',
    'wider covariance', '`error_budget.stars_arcsec`')

# --- one attitude for the whole image ---
TORN_FRAME = Check(
    'TORN_FRAME',
    'chi-square explained by a step of the residuals between two rows, its share of the total, '
    'and its size', 'no attitude',
    'the rows beyond {row:.0f} are {shift_s:.3g} s later than those before: a torn frame')
LINE_TIME = Check(
    'LINE_TIME',
    'chi-square explained by residuals that grow along the rows, over all frames, its share of '
    'the excess, and its size', 'no attitude', 'the residuals grow along the rows: '
    'line_time_us is off by {line_us:.3g} us')
FIRST_LINE_TIME = Check(
    'FIRST_LINE_TIME', 'the same in the first frames; delays one start in 370',
    'no attitude', LINE_TIME.diagnostic)
SECOND_IMAGE = Check(
    'SECOND_IMAGE',
    'missing stars, and their share of all, that have a centroid at one common shift or time',
    'no attitude', '{count} of {stars} stars are seen {shift_px:.1f} px from where the others '
    'have them: a torn frame or a second image')
MISSING_STARS = Check(
    'MISSING_STARS',
    'share of expected stars that are missing, and centroids without a star for each of these',
    'no attitude', 'only {seen} of {stars} stars that should be seen are, and {free} '
    'centroids are not stars')

# --- what is published ---
FEW_STARS = Check(
    'FEW_STARS', 'identified or tracked stars', 'no attitude',
    '{count} {kind} stars, min_stars is {limit}', options='min_stars')
STAR_RESIDUALS = Check(
    'STAR_RESIDUALS', 'rms residual of identified stars', 'no attitude',
    'residual of {residual_px:.2f} px is above max_residual_px = {limit:g}: wrong stars, or an '
    'uncalibrated lens', options='max_residual_px')
TRACK_RESIDUALS = Check(
    'TRACK_RESIDUALS', 'rms distance of the tracks from the attitude of the filter', 'no attitude',
    'the tracks are {residual_px:.2f} px from where tracked_attitude has them, max_residual_px is '
    '{limit:g}', options='max_residual_px')
LARGE_CHI2 = Check(
    'LARGE_CHI2',
    'chi-square of the residuals of N identified stars, of 2 N - 3 degrees of freedom',
    'wider covariance', '`cross_boresight_sigma_arcsec`, `roll_sigma_arcsec`')
COVARIANCE = Check(
    'COVARIANCE', 'published covariance is not finite, symmetric and positive definite',
    'no attitude',
    'the covariance of the attitude is not positive definite, its diagonal is {variances} rad^2: '
    'its errors are not known')
PROTECTION = Check(
    'PROTECTION',
    'separation of the attitudes without one and without two stars; share of undetected false '
    'stars', 'larger bound', '`protection_level_arcsec`',
    options='misleading_probability, false_star_probability')

# --- several heads ---
HEAD_DIFFERS = Check(
    'HEAD_DIFFERS', 'attitude of a head minus that of the body by the others', 'frame not used',
    '{angle_deg:.3g} deg from what other heads and prediction have')
HEAD_RETURNS = Check(
    'HEAD_RETURNS', 'the same for a head that returns', 'frame not used',
    HEAD_DIFFERS.diagnostic)

CHECKS = {name: value for name, value in globals().items() if isinstance(value, Check)}
"""All checks by name, in their order."""


@cache
def _of_reasons() -> dict[int, Check]:
    return {one.reason: one for one in CHECKS.values() if one.reason}


def check_of(reason: int) -> Check | None:
    """Return the check that gives an st_reason_code; None for a reason of another kind."""
    return _of_reasons().get(reason)
