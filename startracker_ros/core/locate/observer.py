# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The inputs of one satellite, combined by stamp into lines of sight to the target."""

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.core.astro.earth import earth_velocity_m_s
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, RESTART_NS, why_no_date
from startracker_ros.core.astro.observer_motion import EARTH_SIGMA_M_S
from startracker_ros.core.astro.state import State
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.locate.line_of_sight import (
    line_of_sight, LineOfSight, without_aberration)
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.core.options import option, Options

_MAX_VALUES = 512
"""Length of a history: several seconds of a fast navigation receiver."""


@dataclass(frozen=True)
class ObserverOptions(Options):
    """How the inputs of one satellite become lines of sight."""

    max_gap_s: float = option(
        1.0, 'longest time between two messages for interpolation, of odometry and of lines of '
        'sight', unit='s', low=1e-3, high=60.0)
    max_lag_s: float = option(
        5.0, 'largest lag of one observer behind the other, in stamps; beyond it the observer '
        'counts as silent', unit='s', low=1e-3, high=600.0)
    aberration: str = option(
        'target', 'target: the attitude is that in ICRF, as attitude_estimator publishes it; '
        'stars_and_target: the attitude is fitted to star directions without aberration; none: '
        'a simulated sky without aberration and light time',
        choices=('target', 'stars_and_target', 'none'))
    position_sigma_m: float = option(
        10.0, '1 sigma position error of an observer per axis, where odometry has no covariance',
        unit='m', low=1e-3, high=1e6)
    timing_sigma_s: float = option(
        1e-3, '1 sigma error of the stamps of an observer', unit='s', low=0.0, high=10.0)


class ObservedLine(NamedTuple):
    """A line of sight and the velocity (3,) of the observer."""

    line: LineOfSight
    velocity_m_s: np.ndarray


class History:
    """Values by stamp, in order of time; the oldest are dropped beyond _MAX_VALUES."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self._values: list[Any] = []

    def add(self, stamp_ns: int, value: Any) -> None:
        """Add a value; it replaces one of the same stamp."""
        index = bisect_left(self.stamps, stamp_ns)
        known = index < len(self.stamps) and self.stamps[index] == stamp_ns
        self.stamps[index:index + known] = [stamp_ns]
        self._values[index:index + known] = [value]
        del self.stamps[:-_MAX_VALUES], self._values[:-_MAX_VALUES]

    def at(self, stamp_ns: int) -> Any:
        """Return the value of a stamp; None if there is none."""
        index = bisect_left(self.stamps, stamp_ns)
        known = index < len(self.stamps) and self.stamps[index] == stamp_ns
        return self._values[index] if known else None

    def around(self, stamp_ns: int) -> tuple[int, Any, int, Any] | None:
        """Return stamp and value before and after; None outside the stamps."""
        index = bisect_left(self.stamps, stamp_ns)
        if not 0 < index < len(self.stamps):
            return None
        return (self.stamps[index - 1], self._values[index - 1],
                self.stamps[index], self._values[index])

    def clear(self) -> None:
        """Remove all values."""
        self.stamps.clear()
        self._values.clear()

    @property
    def newest_ns(self) -> int | None:
        """Return the last stamp; None if there is none."""
        return self.stamps[-1] if self.stamps else None


class Observer:
    """
    The inputs of one satellite, in any order, and its lines of sight.

    camera is that of its star tracker; lines are the lines of sight at its own frames.
    """

    def __init__(self, name: str, options: ObserverOptions = ObserverOptions()) -> None:
        self.name = name
        self.camera: Camera | None = None
        self._options = options
        self._max_gap_ns = round(options.max_gap_s * 1e9)
        self._attitudes, self._targets, self._states = History(), History(), History()
        self.lines = History()
        self._pending: list[int] = []

    def add_state(self, stamp_ns: int, state: State) -> None:
        """Add position and velocity; a covariance of zeros means that it is unknown."""
        if not np.any(state.covariance_m2):
            state = state._replace(
                covariance_m2=np.eye(3) * self._options.position_sigma_m ** 2)
        self._add(self._states, stamp_ns, state)

    def add_attitude(self, stamp_ns: int, quaternion: np.ndarray,
                     covariance: np.ndarray) -> None:
        """Add q_icrf_from_sensor (4,) and its covariance (3, 3) about ICRF axes, rad^2."""
        self._add(self._attitudes, stamp_ns, (quaternion, covariance))

    def add_target(self, stamp_ns: int, uv: np.ndarray, sigma_px: float) -> None:
        """Add the centroid (2,) of the target in the frame of this stamp."""
        self._add(self._targets, stamp_ns, (uv, sigma_px))

    def state_at(self, stamp_ns: int) -> State | None:
        """Return position and velocity at a stamp, interpolated; None outside the odometry."""
        state = self._states.at(stamp_ns)
        around = self._states.around(stamp_ns)
        if state is not None or around is None:
            return state
        begin_ns, begin, end_ns, end = around
        if end_ns - begin_ns > self._max_gap_ns:
            return None
        return _interpolated_state(begin, end, (end_ns - begin_ns) * 1e-9,
                                   (stamp_ns - begin_ns) / (end_ns - begin_ns))

    def line_at(self, stamp_ns: int) -> ObservedLine | None:
        """Return the line of sight at a stamp, interpolated over at most max_gap_s, or None."""
        own = self.lines.at(stamp_ns)
        around = self.lines.around(stamp_ns)
        if own is not None or around is None:
            return own
        begin_ns, begin, end_ns, end = around
        state = self.state_at(stamp_ns)
        if end_ns - begin_ns > self._max_gap_ns or state is None:
            return None
        fraction = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        # Within a second directions change by less than a degree: linear interpolation.
        direction = (begin.line.direction
                     + fraction * (end.line.direction - begin.line.direction))
        covariance = _interpolated_covariance(begin.line.covariance, end.line.covariance, fraction)
        covariance[:3, :3] = state.covariance_m2
        return ObservedLine(
            LineOfSight(state.position_m, direction / np.linalg.norm(direction), covariance),
            state.velocity_m_s)

    def missing_input(self, stamp_ns: int | None = None) -> str:
        """Return the input that is missing or lags behind stamp_ns by more than max_lag_s."""
        inputs = (('odometry', self._states), ('attitude_cov', self._attitudes),
                  ('target_centroid', self._targets))
        if self.camera is None:
            return f'{self.name}: no camera_info'
        for topic, history in inputs:
            newest_ns = history.newest_ns
            if newest_ns is None:
                return f'{self.name}: no {topic}'
            if stamp_ns is not None and (stamp_ns - newest_ns) * 1e-9 > self._options.max_lag_s:
                return (f'{self.name}: {topic} silent, or its clock apart, for '
                        f'{(stamp_ns - newest_ns) * 1e-9:.1f} s')
        return f'{self.name}: target_centroid, attitude_cov and odometry do not meet in time'

    def _add(self, history: History, stamp_ns: int, value: Any) -> None:
        newest_ns = history.newest_ns
        if newest_ns is not None and newest_ns - stamp_ns > RESTART_NS:
            for each in (self._states, self._attitudes, self._targets, self.lines):
                each.clear()
            self._pending.clear()
        history.add(stamp_ns, value)
        if history is self._targets:
            self._pending.append(stamp_ns)
        self._pending = [pending_ns for pending_ns in self._pending[-_MAX_VALUES:]
                         if not self._add_line(pending_ns)]

    def _add_line(self, stamp_ns: int) -> bool:
        """Add the line of sight of a frame; return False while an input is missing."""
        target, attitude = self._targets.at(stamp_ns), self._attitudes.at(stamp_ns)
        state = self.state_at(stamp_ns)
        if target is None or attitude is None or state is None or self.camera is None:
            return False
        (uv, sigma_px), (quaternion, covariance) = target, attitude
        earth_m_s = np.zeros(3)
        if self._options.aberration == 'stars_and_target':
            if why_no_date(stamp_ns):
                covariance = covariance + (EARTH_SIGMA_M_S / SPEED_OF_LIGHT_M_S) ** 2 * np.eye(3)
            else:
                earth_m_s = earth_velocity_m_s(epoch_year_from_stamp(stamp_ns))
        line = line_of_sight(self.camera, uv, sigma_px, quaternion, covariance,
                             state.position_m, state.covariance_m2)
        direction = line.direction
        if self._options.aberration == 'stars_and_target':
            direction = without_aberration(
                direction, state.velocity_m_s,
                boresight=rotate(quaternion, np.array([0.0, 0.0, 1.0])),
                stars_velocity_m_s=state.velocity_m_s + earth_m_s)
        elif self._options.aberration == 'target':
            direction = without_aberration(direction, state.velocity_m_s)
        self.lines.add(stamp_ns, ObservedLine(
            LineOfSight(line.position_m, direction, line.covariance), state.velocity_m_s))
        return True


def _interpolated_state(begin: State, end: State, dt_s: float, fraction: float) -> State:
    """
    Return the state at a fraction s of the time dt_s between two states.

    The position is the cubic Hermite polynomial
    p0 + s (p1 - p0) - s (1 - s) (q - (1 - 2 s) c), with q = dt (v1 - v0) / 2 and
    c = p0 - p1 + dt (v0 + v1) / 2; the velocity is interpolated linearly.
    """
    cubic = begin.position_m - end.position_m + dt_s * (
        begin.velocity_m_s + end.velocity_m_s) / 2
    quadratic = dt_s * (end.velocity_m_s - begin.velocity_m_s) / 2
    product = fraction * (1 - fraction)
    position_m = (begin.position_m + fraction * (end.position_m - begin.position_m)
                  - product * quadratic + product * (1 - 2 * fraction) * cubic)
    return State(position_m,
                 begin.velocity_m_s + fraction * (end.velocity_m_s - begin.velocity_m_s),
                 _interpolated_covariance(begin.covariance_m2, end.covariance_m2, fraction))


def _interpolated_covariance(begin: np.ndarray, end: np.ndarray, fraction: float) -> np.ndarray:
    """
    Return the covariance of a linearly interpolated value.

    Exact for fully correlated errors of both ends, too large for independent ones.
    """
    return (1 - fraction) * begin + fraction * end
