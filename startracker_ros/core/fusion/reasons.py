# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sentence for each reason of a fusion: no attitude, a head or a gyro that is not used."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from startracker_ros.core.integrity.checks import FILTER_COVARIANCE, HEAD_DIFFERS, rate_text
from startracker_ros.core.integrity.reasons import reason_text

_Sentence = Callable[[Sequence[float], Sequence[str]], str]


def _disagree(figures: Sequence[float], names: Sequence[str]) -> str:
    both = ' and '.join(sorted(names[int(number)] for number in figures[:2]))
    return f'{both} disagree by {figures[2]:.3g} deg'


def _none_left(figures: Sequence[float], names: Sequence[str]) -> str:
    return (f'{names[int(figures[0])]} is {HEAD_DIFFERS.sentence(figures[1:])}, and no other '
            'head counts')


def _mounts_wrong(figures: Sequence[float], names: Sequence[str]) -> str:
    wrong = ', '.join(name for number, name in enumerate(names) if int(figures[0]) >> number & 1)
    return f'mount of {wrong} further from mounts_file than its sigma allows'


def _gyro_turns(figures: Sequence[float], names: Sequence[str]) -> str:
    return (f'{_reported(figures)}{names[int(figures[3])]} does not turn so: is it in rad/s, on '
            'the axes of the body, and gyro_drift_deg_h right?')


def _reported(figures: Sequence[float]) -> str:
    return f'imu reports {rate_text(figures[:3])} deg/s about x, y, z of the body, '


_SENTENCES: Mapping[int, _Sentence] = {
    700: lambda *_: 'waiting for frames',
    701: lambda *_: 'no frames of two heads at a time',
    702: _disagree,
    703: lambda *_: 'no head that another one confirms',
    704: _none_left,
    705: lambda figures, _: FILTER_COVARIANCE.sentence(figures),
    706: _mounts_wrong,
    720: lambda *_: 'no frames yet',
    721: lambda *_: 'repeats stamps',
    722: lambda figures, _: f'frames {figures[0]:.1f} s behind the other heads',
    723: lambda figures, _: f'frames {figures[0]:.1f} s ahead of the other heads',
    724: lambda figures, _: (
        f'frames {figures[0]:.1f} s ahead of the other heads, and ahead of imu'),
    725: lambda *_: 'no other head or prediction to check it',
    726: lambda *_: 'is checked after a time without frames',
    727: lambda figures, _: HEAD_DIFFERS.sentence(figures),
    740: lambda figures, _: f'imu is {figures[0]:.2g} s behind the heads',
    741: _gyro_turns,
    742: lambda figures, _: f'{_reported(figures)}the heads {rate_text(figures[3:6])}',
    743: lambda *_: 'the heads agree with each other and not with imu'}
"""By st_fusion_reason, of its figures and the names of the heads."""


def fusion_reason(reason: np.ndarray, names: Sequence[str]) -> str:
    """Return the sentence of an st_reason, empty where there is none."""
    code, _, figures = reason.item()
    return _SENTENCES[code](figures, names) if code in _SENTENCES else reason_text(reason)
