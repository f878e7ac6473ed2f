# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two observers aligned in time: the position of their target, or the reason for none."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.core.locate.line_of_sight import LineOfSight
from startracker_ros.core.locate.location import locate, Location, LocationError, LocationOptions
from startracker_ros.core.locate.observer import ObservedLine, Observer, ObserverOptions

_UNKNOWN_SPEED_M_S = 8000.0
"""1 sigma per axis of an unknown velocity of the target: covers all low orbits."""

_VELOCITY_WINDOW_NS = 10_000_000_000
"""The velocity of the target is the mean over this time."""

_ACCELERATION_M_S2 = 9.8
"""Gravity, which changes the velocity during that time."""


@dataclass(frozen=True)
class Located:
    """The target at a stamp, and the positions observers_m (2, 3) of both observers."""

    stamp_ns: int
    location: Location
    observers_m: np.ndarray


@dataclass(frozen=True)
class Rejected:
    """A stamp without a position, and the reason."""

    stamp_ns: int
    reason: str


class TargetLocator:
    """
    Locates the target at the frames of the first observer.

    Add inputs to `observers`, then call solve(). Positions are corrected for light time, with
    the velocity of the target from its recent positions.
    """

    def __init__(self, names: tuple[str, str],
                 options: ObserverOptions = ObserverOptions(),
                 location_options: LocationOptions = LocationOptions()) -> None:
        self.observers = Observer(names[0], options), Observer(names[1], options)
        self._options = options
        self._location_options = location_options
        self._max_lag_ns = round(options.max_lag_s * 1e9)
        self._done_ns: int | None = None
        self._silent_ns: int | None = None
        self._recent: deque[tuple[int, Location]] = deque()

    def solve(self) -> list[Located | Rejected]:
        """Return the results since the last call, oldest first."""
        first, second = self.observers
        newest_ns, other_ns = first.lines.newest_ns, second.lines.newest_ns
        if newest_ns is not None and self._done_ns is not None and newest_ns < self._done_ns:
            # Time went back: a restart.
            self._done_ns = self._silent_ns = None
            self._recent.clear()
        results: list[Located | Rejected] = []
        for stamp_ns in first.lines.stamps:
            if self._done_ns is not None and stamp_ns <= self._done_ns:
                continue
            own, other = first.line_at(stamp_ns), second.line_at(stamp_ns)
            if other is None and self._may_arrive(stamp_ns):
                break
            self._done_ns = stamp_ns
            results.append(Rejected(stamp_ns, self._why_unmatched(stamp_ns))
                           if own is None or other is None
                           else self._located(stamp_ns, own, other))
        if other_ns is not None and other_ns != self._silent_ns and (
                newest_ns is None or other_ns - newest_ns > self._max_lag_ns):
            self._silent_ns = other_ns
            results.append(Rejected(other_ns, first.missing_input(other_ns)))
        return results

    def missing_inputs(self) -> str:
        """Return the missing inputs of the observers, after a time without results."""
        missing = [observer.missing_input() for observer in self.observers
                   if observer.lines.newest_ns is None
                   or (self._done_ns is not None and observer.lines.newest_ns <= self._done_ns)]
        return '; '.join(missing) or 'no frame of both observers is near enough in time'

    def _may_arrive(self, stamp_ns: int) -> bool:
        """Return whether a line of the second observer for this stamp may still arrive."""
        first, second = self.observers
        newest_ns = second.lines.newest_ns
        if newest_ns is not None and newest_ns >= stamp_ns:
            return False
        return first.lines.newest_ns is None or (
            first.lines.newest_ns - stamp_ns <= self._max_lag_ns)

    def _why_unmatched(self, stamp_ns: int) -> str:
        """Return why the second observer has no line of sight for a stamp."""
        second = self.observers[1]
        stamps = np.array(second.lines.stamps)
        if not len(stamps) or stamps[-1] < stamp_ns:
            return second.missing_input(stamp_ns)
        nearest_s = np.abs(stamps - stamp_ns).min() * 1e-9
        return (f'{second.name}: no two lines of sight within {self._options.max_gap_s:g} s '
                f'around the frame of {self.observers[0].name}, the nearest {nearest_s:.3g} s off')

    def _located(self, stamp_ns: int, *observed: ObservedLine) -> Located | Rejected:
        try:
            location = self._location_at(stamp_ns, observed)
        except LocationError as error:
            return Rejected(stamp_ns, str(error))
        self._recent.append((stamp_ns, location))
        while stamp_ns - self._recent[0][0] > _VELOCITY_WINDOW_NS:
            self._recent.popleft()
        return Located(stamp_ns, location, np.array([one.line.position_m for one in observed]))

    def _location_at(self, stamp_ns: int, observed: tuple[ObservedLine, ...]) -> Location:
        """Return the location, corrected for the motion of the target during the light time."""
        velocity_m_s, sigma_m_s = self._velocity(stamp_ns)
        # An error of the stamps moves a line by the relative velocity.
        first, second = (_inflated(one.line, self._options.timing_sigma_s,
                                   one.velocity_m_s - velocity_m_s, sigma_m_s)
                         for one in observed)
        if self._options.aberration == 'none':
            return locate(first, second, self._location_options)
        # The ranges for the light time follow from any lines that meet in front.
        uncorrected = locate(first, second,
                             replace(self._location_options, max_miss_sigmas=1000.0))
        first, second = (
            _inflated(replace(line, position_m=line.position_m + velocity_m_s * delay_s), delay_s,
                      np.zeros(3), sigma_m_s)
            for line, delay_s in zip((first, second), uncorrected.range_m / SPEED_OF_LIGHT_M_S))
        return locate(first, second, self._location_options)

    def _velocity(self, stamp_ns: int) -> tuple[np.ndarray, float]:
        """Return the velocity (3,) of the target and its 1 sigma on each axis, m/s."""
        recent = [entry for entry in self._recent if stamp_ns - entry[0] <= _VELOCITY_WINDOW_NS]
        if len(recent) < 2:
            return np.zeros(3), _UNKNOWN_SPEED_M_S
        (begin_ns, begin), (end_ns, end) = recent[0], recent[-1]
        dt_s = (end_ns - begin_ns) * 1e-9
        variance = np.trace(begin.covariance_m2 + end.covariance_m2) / 3 / dt_s ** 2
        sigma_m_s = np.sqrt(variance + (_ACCELERATION_M_S2 * (stamp_ns - begin_ns) * 1e-9) ** 2)
        return (end.position_m - begin.position_m) / dt_s, float(min(sigma_m_s,
                                                                     _UNKNOWN_SPEED_M_S))


def _inflated(line: LineOfSight, time_s: float, velocity_m_s: np.ndarray, sigma_m_s: float
              ) -> LineOfSight:
    """Return a line whose position covariance includes time_s^2 (v v' + sigma^2 I)."""
    covariance = line.covariance.copy()
    covariance[:3, :3] += time_s ** 2 * (np.outer(velocity_m_s, velocity_m_s)
                                         + sigma_m_s ** 2 * np.eye(3))
    return replace(line, covariance=covariance)
