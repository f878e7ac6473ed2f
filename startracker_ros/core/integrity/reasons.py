# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sentence for each reason of the library why there is no attitude, or what was done."""

from collections.abc import Callable, Sequence

import numpy as np
from startracker_ros.core.attitude.result import UNSOLVED
from startracker_ros.core.integrity.checks import (
    BAD_FRAMES, Check, COVARIANCE, DIVERGED, FEW_STARS, FILTER_COVARIANCE, GYRO_AT_RANGE,
    GYRO_BLIND, GYRO_DIFFERS, IDENTIFICATION_DIFFERS, LINE_TIME, MISFIT, MISSING_STARS, NO_STARS,
    REPEATED_FRAME, SECOND_IMAGE, SECOND_TOO_LATE, STAR_RESIDUALS, START_RATE, STARS_ELSEWHERE,
    TIME_JUMP, TORN_FRAME, TRACK_RESIDUALS)

_Text = Callable[[Sequence[float]], str]
_WHOLE = {'frames', 'stars', 'count', 'seen', 'free'}


def rate_text(rate_rad_s: np.ndarray) -> str:
    """Return a rate (3,) as text, in deg/s."""
    return ' '.join(f'{value:.4f}' for value in np.degrees(rate_rad_s))


def _of(check: Check, names: str = '') -> _Text:
    """Return the sentence of a check, whose fields are figures with these names, in their order."""
    fields = names.split()
    return lambda figures: check.diagnostic.format(**{
        name: int(figure) if name in _WHOLE else figure
        for name, figure in zip(fields, figures)})


def _stars(text: str) -> _Text:
    return lambda figures: text.format(int(figures[0]))


def _always(text: str) -> _Text:
    return lambda figures: text


def _rates(figures: Sequence[float]) -> str:
    return GYRO_DIFFERS.diagnostic.format(
        reported=rate_text(np.array(figures[:3])), stars=rate_text(np.array(figures[3:6])))


def _few_stars(figures: Sequence[float]) -> str:
    count, limit, tracked = map(int, figures[:3])
    return FEW_STARS.diagnostic.format(
        count=count, kind='tracked' if tracked else 'identified', limit=limit)


# By st_reason_code, of the figures of the reason.
_TEXTS: dict[int, _Text] = {
    0: _always(''),
    300: _always('waiting for an identified frame'),
    301: _of(TIME_JUMP, 'back_s'),
    302: _of(SECOND_TOO_LATE, 'max_gap_s'),
    303: _of(MISFIT, 'stars residual_px limit'),
    304: _stars('first identification, {} stars'),
    305: _of(START_RATE, 'rate_deg_s'),
    306: _stars('{} stars identified twice'),
    307: _stars('{} stars identified where a hint has them'),
    308: _stars('{} stars where the tracks before had them'),
    309: _of(STARS_ELSEWHERE, 'frames stars'),
    310: _of(IDENTIFICATION_DIFFERS, 'error_deg'),
    311: _of(NO_STARS, 'gap_s'),
    312: _of(DIVERGED, 'frames sigmas last'),
    313: _of(GYRO_BLIND),
    314: lambda figures: FILTER_COVARIANCE.diagnostic.format(variances=list(figures)),
    315: _of(BAD_FRAMES, 'frames stars residual_px'),
    400: _of(TORN_FRAME, 'row shift_s'),
    401: _of(LINE_TIME, 'line_us'),
    402: _of(SECOND_IMAGE, 'count stars shift_px'),
    403: _of(MISSING_STARS, 'seen stars free'),
    404: _of(REPEATED_FRAME),
    500: _of(GYRO_AT_RANGE),
    501: _rates,
    502: _always('the stars are not where the roll of imu has them: is it in rad/s and on the axes '
                 'of the sensor?'),
    503: _always('no rates of imu: roll_by_gyro has no effect'),
    600: _always('trusted'),
    601: _always('the star tracker has none'),
    602: _few_stars,
    603: _of(STAR_RESIDUALS, 'residual_px limit'),
    604: _of(TRACK_RESIDUALS, 'residual_px limit'),
    605: lambda figures: COVARIANCE.diagnostic.format(variances=list(figures[:3])),
    606: _always(UNSOLVED['not_finite']),
    607: lambda figures: UNSOLVED['sigma'].format(figures[0]),
    608: _always(UNSOLVED['zero_length']),
    609: lambda figures: UNSOLVED['same_star'].format(*map(int, figures[:2])),
    610: _always(UNSOLVED['parallel'])}


def reason_text(reason: np.ndarray) -> str:
    """Return the sentence of an st_reason, empty where there is none."""
    code, _, figures = reason.item()
    return _TEXTS[code](figures)
