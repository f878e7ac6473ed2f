# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sentence for each reason of the library why there is no attitude, or what was done."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from startracker_ros.core.attitude.result import failure, FAILURES
from startracker_ros.core.integrity.checks import CHECKS

_TEXTS: Mapping[int, str] = {
    0: '',
    300: 'waiting for an identified frame',
    304: 'first identification, {stars:.0f} stars',
    306: '{stars:.0f} stars identified twice',
    307: '{stars:.0f} stars identified where a hint has them',
    308: '{stars:.0f} stars where the tracks before had them',
    502: 'the stars are not where the roll of imu has them: is it in rad/s and on the axes of the '
         'sensor?',
    503: 'no rates of imu: roll_by_gyro has no effect',
    600: 'trusted',
    601: 'the star tracker has none'}
"""By st_reason_code, of reasons that no check has."""

_CHECKS: Mapping[int, Callable[[Sequence[float]], str]] = {
    check.reason: check.sentence for check in CHECKS.values() if check.reason}


def reason_text(reason: np.ndarray) -> str:
    """Return the sentence of an st_reason, empty where there is none."""
    code, _, figures = reason.item()
    if code in _TEXTS:
        return _TEXTS[code].format(stars=figures[0])
    return failure(code, figures) if code in FAILURES else _CHECKS[code](figures)
