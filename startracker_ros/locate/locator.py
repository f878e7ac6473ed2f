"""Two observers, aligned in time: where their target is, or why that is not known."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.locate.location import locate, Location, LocationError, LocationOptions
from startracker_ros.locate.observer import Observer, ObserverOptions, TimedSight
from startracker_ros.locate.sight import Sight

_UNKNOWN_SPEED_M_S = 8000.0
"""1 sigma on each axis for a target whose motion is not known yet: any in a low orbit."""

_MEMORY_NS = 10_000_000_000
_ACCELERATION_M_S2 = 9.8
"""The velocity is the mean of so much time; gravity bends it meanwhile."""


@dataclass(frozen=True)
class Located:
    """The target at a time, and where both observers were, observers_m (2, 3)."""

    stamp_ns: int
    location: Location
    observers_m: np.ndarray


@dataclass(frozen=True)
class Refused:
    """A time without an answer, and the reason."""

    stamp_ns: int
    reason: str


class TargetLocator:
    """
    Locates the target at the frames of the first observer.

    Feed observers, then call solve(). Where light takes its time the place is that at the
    stamp, not that at which the light set out: the velocity of the target follows from
    the places before.
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
        self._places: deque[tuple[int, Location]] = deque()

    def solve(self) -> list[Located | Refused]:
        """Return what has become known since the last call, oldest first."""
        first, second = self.observers
        newest_ns, other_ns = first.sights.newest_ns, second.sights.newest_ns
        if newest_ns is not None and self._done_ns is not None and newest_ns < self._done_ns:
            # Time went back: what was is no guide to what is.
            self._done_ns = self._silent_ns = None
            self._places.clear()
        results: list[Located | Refused] = []
        for stamp_ns in first.sights.stamps:
            if self._done_ns is not None and stamp_ns <= self._done_ns:
                continue
            own, other = first.sight_at(stamp_ns), second.sight_at(stamp_ns)
            if other is None and self._may_come(stamp_ns):
                break
            self._done_ns = stamp_ns
            results.append(Refused(stamp_ns, self._why_apart(stamp_ns))
                           if own is None or other is None
                           else self._located(stamp_ns, own, other))
        if other_ns is not None and other_ns != self._silent_ns and (
                newest_ns is None or other_ns - newest_ns > self._max_lag_ns):
            self._silent_ns = other_ns
            results.append(Refused(other_ns, first.why_silent(other_ns)))
        return results

    def why_silent(self) -> str:
        """Return what the observers lack, for a time in which nothing came of them."""
        nothing_new = [one.why_silent() for one in self.observers
                       if one.sights.newest_ns is None
                       or (self._done_ns is not None and one.sights.newest_ns <= self._done_ns)]
        return '; '.join(nothing_new) or 'no frame of both observers is near enough in time'

    def _may_come(self, stamp_ns: int) -> bool:
        """Return whether the second observer may still tell of a time."""
        first, second = self.observers
        newest_ns = second.sights.newest_ns
        if newest_ns is not None and newest_ns >= stamp_ns:
            return False
        return first.sights.newest_ns is None or (
            first.sights.newest_ns - stamp_ns <= self._max_lag_ns)

    def _why_apart(self, stamp_ns: int) -> str:
        second = self.observers[1]
        stamps = np.array(second.sights.stamps)
        if not len(stamps) or stamps[-1] < stamp_ns:
            return second.why_silent(stamp_ns)
        nearest_s = np.abs(stamps - stamp_ns).min() * 1e-9
        return (f'{second.name}: no two lines of sight within {self._options.max_gap_s:g} s '
                f'around the frame of {self.observers[0].name}, the nearest {nearest_s:.3g} s off')

    def _located(self, stamp_ns: int, *seen: TimedSight) -> Located | Refused:
        try:
            location = self._joined(stamp_ns, seen)
        except LocationError as error:
            return Refused(stamp_ns, str(error))
        self._places.append((stamp_ns, location))
        while stamp_ns - self._places[0][0] > _MEMORY_NS:
            self._places.popleft()
        return Located(stamp_ns, location, np.array([one.sight.position_m for one in seen]))

    def _joined(self, stamp_ns: int, seen: tuple[TimedSight, ...]) -> Location:
        """Return the location, the lines of sight moved by what the target does meanwhile."""
        velocity_m_s, sigma_m_s = self._velocity(stamp_ns)
        # Wrong stamps move a line by the difference of both velocities.
        first, second = (_uncertain(one.sight, self._options.timing_sigma_s,
                                    one.velocity_m_s - velocity_m_s, sigma_m_s) for one in seen)
        if self._options.aberration == 'none':
            return locate(first, second, self._location_options)
        # How far is known well enough from any pair of lines that meet in front.
        about = locate(first, second, replace(self._location_options, max_miss_sigmas=1000.0))
        first, second = (
            _uncertain(replace(line, position_m=line.position_m + velocity_m_s * delay_s), delay_s,
                       np.zeros(3), sigma_m_s)
            for line, delay_s in zip((first, second), about.range_m / SPEED_OF_LIGHT_M_S))
        return locate(first, second, self._location_options)

    def _velocity(self, stamp_ns: int) -> tuple[np.ndarray, float]:
        """Return the velocity (3,) of the target and its 1 sigma on each axis, m/s."""
        recent = [place for place in self._places if stamp_ns - place[0] <= _MEMORY_NS]
        if len(recent) < 2:
            return np.zeros(3), _UNKNOWN_SPEED_M_S
        (begin_ns, begin), (end_ns, end) = recent[0], recent[-1]
        dt_s = (end_ns - begin_ns) * 1e-9
        variance = np.trace(begin.covariance_m2 + end.covariance_m2) / 3 / dt_s ** 2
        sigma_m_s = np.sqrt(variance + (_ACCELERATION_M_S2 * (stamp_ns - begin_ns) * 1e-9) ** 2)
        return (end.position_m - begin.position_m) / dt_s, float(min(sigma_m_s,
                                                                     _UNKNOWN_SPEED_M_S))


def _uncertain(line: Sight, time_s: float, motion_m_s: np.ndarray, sigma_m_s: float) -> Sight:
    """Return a line of sight, less sure of its place by motion (3,) over a time."""
    covariance = line.covariance.copy()
    covariance[:3, :3] += time_s ** 2 * (np.outer(motion_m_s, motion_m_s)
                                         + sigma_m_s ** 2 * np.eye(3))
    return replace(line, covariance=covariance)
