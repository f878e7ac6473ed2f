# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Every check that decides whether a frame is used and an attitude is trusted: the one table.

Code that evaluates a check takes its threshold, and its sentence, from here. docs/integrity.md is
this table, made by startracker_ros.ros.tables. Free of compiled code, which is slow to import.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Literal

from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.maths.gates import gate

Action = Literal['star not used', 'frame not used', 'rates not used', 'hint not used',
                 'next hypothesis', 'other stars', 'wider covariance', 'larger bound', 'restart',
                 'no attitude']


@dataclass(frozen=True)
class Check:
    """
    One check: the action follows where the evidence is beyond the threshold.

    diagnostic is the sentence that a user reads, with fields for its figures, or the `keys` of
    diagnostics that show it; empty where another hypothesis is tried. probability is that of the
    threshold by chance, of a chi-square of dof degrees of freedom (0: of no chi-square). limits
    are those of figures without a known distribution, by names with their units, and options the
    parameters that are limits. frames are those that the check looks at, in a row or the first.
    """

    evidence: str
    action: Action
    diagnostic: str
    probability: float = 0.0
    dof: int = 0
    limits: Mapping[str, float] = field(default_factory=dict)
    options: str = ''
    frames: int = 0

    @cached_property
    def threshold(self) -> float:
        """The chi-square that is exceeded with the probability."""
        return gate(self.probability, self.dof)

    @cached_property
    def sigmas(self) -> float:
        """The square root of the threshold."""
        return math.sqrt(self.threshold)


# --- frames, as they come ---
LATE_FRAME = Check(
    'stamp not newer than the last one, and older by no more than a limit', 'frame not used',
    '`late_frames`', limits={'back_s': RESTART_NS / 1e9})
TIME_JUMP = Check('stamp older by more: a simulation or a recording starts again', 'restart',
                  'time jumped back by {back_s:.1f} s')
REPEATED_FRAME = Check(
    'positions equal those of the frame before to the last digit, of a source whose brightest '
    'star has moved by more than one image may give, searched in another way', 'frame not used',
    'the centroids are those of the frame before, with their noise', limits={'moved_px': 0.02})
UNUSABLE_CENTROID = Check('position or sigma is not finite, or sigma not positive',
                          'star not used', '`rejected_centroids`')

# --- the start ---
MISFIT = Check(
    'rms residual of the identified stars', 'frame not used',
    '{stars} identified stars fit to {residual_px:.2g} px rms, max_residual_px is {limit:g}: '
    'calibrate the lens', options='max_residual_px')
SECOND_TOO_LATE = Check('time since the first identification', 'restart',
                        'no second identification within {max_gap_s:g} s', options='max_gap_s')
START_RATE = Check('rate between two identifications', 'restart',
                   'two identifications {rate_deg_s:.3g} deg/s apart', options='max_rate_deg_s')
HINT = Check('1 sigma of attitude and rate of a hint, about any axis', 'hint not used', '`reason`',
             limits={'sigma_deg': 2.0, 'rate_sigma_deg_s': 0.5})
HINT_DIFFERS = Check('identified attitude minus that of a hint, or of tracks before',
                     'hint not used', '`reason`', 1e-5, 3)
HINT_FAILED = Check('good frames from a start by a hint to the loss of the stars',
                    'hint not used', '`reason`', frames=5)
IDENTIFICATION_DIFFERS = Check(  # 10 sigma: beyond errors of the lens, below wrong stars by far
    'identified attitude minus that of the tracks, and its rms residual over max_residual_px',
    'restart', 'an identification contradicts the tracks by {error_deg:.3g} deg',
    1.55415943139e-21, 3, {'residual_ratio': 3.0})

# --- the filter ---
STAR_OUTLIER = Check(  # 5 sigma
    'residual of a star over its sigma', 'star not used', '`residual_px`', 3.72665317208e-6, 2)
LIKELY_INNOVATION = Check(
    'innovation of the attitude by a motion before the widest one: the smallest one that is '
    'likely is taken', 'next hypothesis', '', 0.05, 3)
INNOVATION = Check('innovation of the attitude by the last motion', 'frame not used',
                   '`frames_since_fix`', 1e-5, 3)
FEW_AGREE = Check(
    'stars that fit the corrected attitude, of those in the image, and their rms residual',
    'frame not used', '`stars_matched`', limits={'stars_for_one': 3},
    options='min_stars, max_residual_px')
BAD_FRAMES = Check(
    'frames in a row that are not used', 'restart', '{frames} bad frames: {stars} stars agreed in '
    'the last one, residual {residual_px:.2f} px', options='max_bad_frames')
STARS_ELSEWHERE = Check(
    'identified frames in a row that are not used', 'restart',
    '{frames} bad frames, but {stars} stars identified', frames=2)
NO_STARS = Check('time since the last frame that was used', 'restart',
                 'no stars for {gap_s:.1f} s', options='max_gap_s')
DIVERGED = Check(  # 20 sigma
    'innovation by stars that agree, in frames in a row', 'restart',
    'the filter has diverged: {frames} frames in a row with innovations beyond {sigmas:g} sigma, '
    'the last of {last:.0f}', 2.2138865931e-86, 3, frames=5)
FILTER_COVARIANCE = Check(
    'covariance of the filter is not finite, or not positive definite', 'restart',
    'the covariance of the filter is not positive definite, its diagonal is {variances}')
SHEARED_STARS = Check(
    'stars of a rolling shutter that are not where a motion has them: exposed after a jump',
    'next hypothesis', '', limits={'stars': 3})
FAST_TURN = Check(
    'share of the width of the image that stars move in a frame, in which those followed may '
    'leave it, and distance of a centroid that may be that of one of them', 'other stars',
    '`reason`', limits={'width_share': 0.02, 'neighbourhood_px': 10.0})

# --- a gyro ---
GYRO_SILENT = Check('age of the newest rate', 'rates not used', '`gyro`', limits={'age_s': 1.0})
GYRO_AT_RANGE = Check(
    'rates at gyro_range_deg_s', 'rates not used', 'imu reaches gyro_range_deg_s: its rates are '
    'not used while the true ones may be larger')
GYRO_DIFFERS = Check(  # twice: the light of one frame may be that of a body that was kicked
    'turn by the rates minus that by the stars, in frames in a row', 'rates not used',
    'imu reports {reported} deg/s about x, y, z, the stars {stars}: is it in rad/s, on the axes '
    'of the sensor, and gyro_drift_deg_h right?', 1e-5, 3, frames=2)
GYRO_BLIND = Check(
    'rates at gyro_range_deg_s in a frame of too few stars', 'restart',
    'imu reaches gyro_range_deg_s while there are no stars: the attitude is not known')
MOTION_ENDS = Check('probability of the mode of motion before, by the rates since',
                    'next hypothesis', '', 1e-3)

# --- errors that the stars show or do not exclude, in the error budget ---
JUMP_IN_FRAME = Check(
    'probability of a motion that begins within the frame, times the share of the interval that '
    'is exposed; that the stamp errs, at least', 'wider covariance',
    '`error_budget.motion_arcsec`', 0.02)
DISPLACED = Check(  # no body jumps and goes on as before, but images of another time do
    'rate in the frames after a jump is within the threshold from that before it',
    'wider covariance', '`error_budget.motion_arcsec`', 0.05, 3, frames=4)
STAMP_ERRORS = Check(
    'variance of the stamps by turns along the rate that change sign, over that by the centroids, '
    'by so many products: `many` plus `few` over their number, `expected` in place of `many` '
    'where stamps have erred, and `shaken` times the variance across the rate; in the first '
    'frames up to `first_s` whatever they do not exclude', 'wider covariance',
    '`error_budget.stamps_arcsec`, `stamp_sigma_ms`', limits={
        'products': 3, 'many': 2.5, 'few': 15.0, 'expected': 2.0, 'shaken': 2.0, 'first_s': 5e-3},
    frames=10)
LENS_ERROR = Check(  # 4 sigma
    'product of the residuals of a star in two frames in a row, over all; and a common scale',
    'wider covariance', '`error_budget.lens_arcsec`', 6.33424836662e-5, 1, {'stars': 6})
ERROR_SCALE = Check(
    'median residual of the stars over that by their sigma, of all and of the precise half',
    'wider covariance', '`error_budget.stars_arcsec`',
    limits={'large': 1.15, 'small': 0.9, 'least': 0.5}, frames=20)

# --- one attitude in all of an image ---
TORN_FRAME = Check(  # 6 sigma
    'chi-square that a step of the residuals between two rows explains, its share of all, and its '
    'size', 'no attitude', 'the rows beyond {row:.0f} are {shift_s:.3g} s later than those '
    'before: a torn frame', 1.973175290075e-9, 1,
    {'stars': 8, 'explained_share': 0.5, 'step_px': 0.1})
LINE_TIME = Check(  # chi-square of 20
    'chi-square that a growth of the residuals along the rows explains, of all frames, its share '
    'of the excess, and its size', 'no attitude', 'the residuals grow along the rows: '
    'line_time_us is off by {line_us:.3g} us', 7.74421643104e-6, 1,
    {'explained_share': 0.2, 'slope_px': 0.05})
FIRST_LINE_TIME = Check('the same in the first frames, which show little: one start in 370 waits',
                        'no attitude', LINE_TIME.diagnostic, 2.69979606326e-3, 1, frames=5)
SECOND_IMAGE = Check(
    'missing stars, and their share of all, that are seen by one shift or time away',
    'no attitude', '{count} of {stars} stars are seen {shift_px:.1f} px from where the others '
    'have them: a torn frame or a second image',
    limits={'stars': 4, 'share': 0.2, 'reach_px': 80.0, 'present_px': 0.5})
MISSING_STARS = Check(
    'share of the stars that should be seen and are not, and centroids that are no star for each '
    'of these', 'no attitude', 'only {seen} of {stars} stars that should be seen are, and {free} '
    'centroids are no star', limits={'missed_share': 0.4, 'placed_share': 0.7})

# --- what is published ---
FEW_STARS = Check('identified or tracked stars', 'no attitude',
                  '{count} {kind} stars, min_stars is {limit}', options='min_stars')
STAR_RESIDUALS = Check(
    'rms residual of identified stars', 'no attitude', 'residual of {residual_px:.2f} px is above '
    'max_residual_px = {limit:g}: wrong stars, or an uncalibrated lens', options='max_residual_px')
TRACK_RESIDUALS = Check(
    'rms distance of the tracks from the attitude of the filter', 'no attitude',
    'the tracks are {residual_px:.2f} px from where tracked_attitude has them, max_residual_px is '
    '{limit:g}', options='max_residual_px')
LARGE_CHI2 = Check(  # always scaled, covariances of few stars would be too large on average
    'chi-square of the residuals of N identified stars, of 2 N - 3 degrees of freedom',
    'wider covariance', '`cross_boresight_sigma_arcsec`, `roll_sigma_arcsec`', 1e-3)
COVARIANCE = Check(
    'published covariance is not finite, symmetric and positive definite', 'no attitude',
    'the covariance of the attitude is not positive definite, its diagonal is {variances} rad^2: '
    'its errors are not known')
PROTECTION = Check(  # each rejected star says that there may be others
    'separation of the attitudes without one and without two stars; share of false stars that no '
    'test rejects', 'larger bound', '`protection_level_arcsec`', 1e-4,
    options='misleading_probability, false_star_probability')

# --- several heads ---
HEAD_DIFFERS = Check(
    'attitude of a head minus that of the body by the others', 'frame not used',
    '{angle_deg:.3g} deg from what other heads and prediction have', 1e-6, 3)
HEAD_RETURNS = Check(  # 3 sigma: chance is only later for it, a larger error would be let in
    'the same, of a head that is to count again', 'frame not used',
    HEAD_DIFFERS.diagnostic, 0.0292908865349, 3)

CHECKS = {name: value for name, value in globals().items() if isinstance(value, Check)}
"""All checks by name, in their order."""
