# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One head: its frames, and whether it counts."""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
import math

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.fusion.native_fusion import NativeFusion


class HeadState(StrEnum):
    """Whether the frames of a head count."""

    WAITING = 'waiting'
    CHECKED = 'checked'
    USED = 'used'
    EXCLUDED = 'excluded'


_STATES = tuple(HeadState)
_COUNTS = {'used': 'used', 'repeated stamps': 'repeated', 'late': 'late', 'ahead': 'ahead',
           'disagreeing': 'disagreeing', 'agreeing, not counted yet': 'not_counted_yet'}


@dataclass(frozen=True)
class HeadFrame:
    """
    A measured attitude of a head.

    quaternion (4,) is q_icrf_from_sensor, covariance (3, 3) rad^2 about sensor axes. ValueError
    when these are not an attitude.
    """

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray

    def __post_init__(self) -> None:
        # Python's floats: NumPy takes ten times as long for so few numbers.
        q, C = self.quaternion.tolist(), self.covariance.tolist()
        # Written so that NaN is rejected.
        if not abs(math.hypot(*q) - 1) < 1e-6:
            raise ValueError(f'quaternion {q} is not an attitude')
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = C
        # Sylvester's criterion.
        minor = xx * yy - xy * yx
        determinant = (xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx)
                       + xz * (yx * zy - yy * zx))
        if not (0 < xx < math.inf and 0 < minor < math.inf and 0 < determinant < math.inf):
            raise ValueError(f'covariance {C} is not positive definite')


class Head:
    """A head of a fusion: each property is that of now."""

    def __init__(self, fusion: NativeFusion, number: int) -> None:
        self._fusion, self._number = fusion, number
        self._found = np.zeros((), native.HEAD)
        self._found_at = self._found.ctypes.data

    def _known(self, stamp_ns: int = 0) -> np.ndarray:
        """Return its HEAD at a time."""
        self._fusion.call('head', self._number, stamp_ns, self._found_at)
        return self._found

    @property
    def state(self) -> HeadState:
        """Return whether its frames count."""
        return _STATES[self._known()['state']]

    @property
    def reason(self) -> str:
        """Return why it does not count, empty where it does."""
        return self._fusion.sentence(self._known()['reason'])

    @property
    def counts(self) -> Counter[str]:
        """Return its frames by what became of them."""
        known = self._known()
        return +Counter({text: int(known[name]) for text, name in _COUNTS.items()})

    @property
    def noise_scale(self) -> float:
        """Return the scale by which its covariance is multiplied."""
        return float(self._known()['noise_scale'])

    @property
    def stands_out(self) -> bool:
        """Return whether its errors are so large that a user should know."""
        return bool(self._known()['stands_out'])

    @property
    def needs_temperature(self) -> bool:
        """Return whether its mount bends with a temperature that has not come."""
        return bool(self._known()['needs_temperature'])

    def is_silent(self, stamp_ns: int) -> bool:
        """Return whether it has had no frame that counts for long before a time."""
        return bool(self._known(stamp_ns)['silent'])

    def set_temperature(self, celsius: float) -> bool:
        """Use a temperature; False for one that no head has: NaN, or one in kelvin."""
        return not self._fusion.status_of('add_temperature', self._number, celsius)
