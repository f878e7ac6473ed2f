"""What one satellite says of the target, brought together by stamps."""

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.astro.planets import earth_velocity_m_s
from startracker_ros.astro.state import State
from startracker_ros.camera.model import Camera
from startracker_ros.locate.sight import Sight, sight, without_aberration
from startracker_ros.maths.rotation import rotate
from startracker_ros.options import option, Options

KEPT = 512
"""Messages of a topic kept: several seconds of a fast receiver."""

RESTART_NS = 1_000_000_000
"""A step back by more is a restarted simulation or a looped bag."""


@dataclass(frozen=True)
class ObserverOptions(Options):
    """How the messages of one satellite become a line of sight."""

    max_gap_s: float = option(
        1.0, 'longest time between two messages that is bridged by interpolation, of odometry as '
        'of lines of sight', unit='s', low=1e-3, high=60.0)
    max_lag_s: float = option(
        5.0, 'how far, in stamps, one observer may lag behind the other before it counts as '
        'silent', unit='s', low=1e-3, high=600.0)
    aberration: str = option(
        'stars_and_target', 'stars_and_target: the attitude is fitted to stars whose places are '
        'without aberration, as attitude_estimator does; target: the attitude is free of it; '
        'none: a simulated sky without aberration and without the time that light takes',
        choices=('stars_and_target', 'target', 'none'))
    position_sigma_m: float = option(
        10.0, 'error of an observer on each axis, 1 sigma, where odometry brings no covariance',
        unit='m', low=1e-3, high=1e6)
    timing_sigma_s: float = option(
        1e-3, 'error of the stamps of an observer, 1 sigma', unit='s', low=0.0, high=10.0)


class TimedSight(NamedTuple):
    """A line of sight and the velocity (3,) of the observer."""

    sight: Sight
    velocity_m_s: np.ndarray


class History:
    """Values by stamp, in order of time; the oldest leave when there are many."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self._values: list[Any] = []

    def add(self, stamp_ns: int, value: Any) -> None:
        """Take a value; one of the same stamp is replaced."""
        index = bisect_left(self.stamps, stamp_ns)
        known = index < len(self.stamps) and self.stamps[index] == stamp_ns
        self.stamps[index:index + known] = [stamp_ns]
        self._values[index:index + known] = [value]
        del self.stamps[:-KEPT], self._values[:-KEPT]

    def at(self, stamp_ns: int) -> Any:
        """Return the value of a stamp, None without one."""
        index = bisect_left(self.stamps, stamp_ns)
        known = index < len(self.stamps) and self.stamps[index] == stamp_ns
        return self._values[index] if known else None

    def around(self, stamp_ns: int) -> tuple[int, Any, int, Any] | None:
        """Return the stamps and values before and after; None outside of what is known."""
        index = bisect_left(self.stamps, stamp_ns)
        if not 0 < index < len(self.stamps):
            return None
        return (self.stamps[index - 1], self._values[index - 1],
                self.stamps[index], self._values[index])

    def clear(self) -> None:
        """Forget everything."""
        self.stamps.clear()
        self._values.clear()

    @property
    def newest_ns(self) -> int | None:
        """Return the last stamp, None when there is nothing."""
        return self.stamps[-1] if self.stamps else None


class Observer:
    """
    One satellite: add what it says in any order, ask for its line of sight at a time.

    camera is that of its star tracker; sights are those of its own frames.
    """

    def __init__(self, name: str, options: ObserverOptions = ObserverOptions()) -> None:
        self.name = name
        self.camera: Camera | None = None
        self._options = options
        self._max_gap_ns = round(options.max_gap_s * 1e9)
        self._attitudes, self._targets, self._states = History(), History(), History()
        self.sights = History()
        self._waiting: list[int] = []

    def add_state(self, stamp_ns: int, state: State) -> None:
        """Take position and velocity; a covariance of zeros stands for none."""
        if not np.any(state.covariance_m2):
            state = state._replace(
                covariance_m2=np.eye(3) * self._options.position_sigma_m ** 2)
        self._add(self._states, stamp_ns, state)

    def add_attitude(self, stamp_ns: int, quaternion: np.ndarray,
                     covariance: np.ndarray) -> None:
        """Take q_icrf_from_sensor (4,) and its covariance (3, 3) about ICRF axes, rad^2."""
        self._add(self._attitudes, stamp_ns, (quaternion, covariance))

    def add_target(self, stamp_ns: int, uv: np.ndarray, sigma_px: float) -> None:
        """Take the target's centroid (2,) in the frame of this stamp."""
        self._add(self._targets, stamp_ns, (uv, sigma_px))

    def state_at(self, stamp_ns: int) -> State | None:
        """Return position and velocity at a time, interpolated; None without neighbours."""
        state = self._states.at(stamp_ns)
        around = self._states.around(stamp_ns)
        if state is not None or around is None:
            return state
        begin_ns, begin, end_ns, end = around
        if end_ns - begin_ns > self._max_gap_ns:
            return None
        dt_s = (end_ns - begin_ns) * 1e-9
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        # Cubic Hermite: what velocities at both ends allow.
        rest = begin.position_m - end.position_m + dt_s * (
            begin.velocity_m_s + end.velocity_m_s) / 2
        lean = dt_s * (end.velocity_m_s - begin.velocity_m_s) / 2
        part = share * (1 - share)
        position_m = (begin.position_m + share * (end.position_m - begin.position_m)
                      - part * lean + part * (1 - 2 * share) * rest)
        return State(position_m,
                     begin.velocity_m_s + share * (end.velocity_m_s - begin.velocity_m_s),
                     _mixed(begin.covariance_m2, end.covariance_m2, share))

    def sight_at(self, stamp_ns: int) -> TimedSight | None:
        """Return the line of sight at a time, interpolated; None without near neighbours."""
        own = self.sights.at(stamp_ns)
        around = self.sights.around(stamp_ns)
        if own is not None or around is None:
            return own
        begin_ns, begin, end_ns, end = around
        state = self.state_at(stamp_ns)
        if end_ns - begin_ns > self._max_gap_ns or state is None:
            return None
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        # A second apart they differ by less than a degree: the chord is as even as the arc.
        direction = begin.sight.direction + share * (end.sight.direction - begin.sight.direction)
        covariance = _mixed(begin.sight.covariance, end.sight.covariance, share)
        covariance[:3, :3] = state.covariance_m2
        return TimedSight(
            Sight(state.position_m, direction / np.linalg.norm(direction), covariance),
            state.velocity_m_s)

    def why_silent(self, stamp_ns: int | None = None) -> str:
        """Return which input is missing, or lags behind stamp_ns too far."""
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
            for each in (self._states, self._attitudes, self._targets, self.sights):
                each.clear()
            self._waiting.clear()
        history.add(stamp_ns, value)
        if history is self._targets:
            self._waiting.append(stamp_ns)
        self._waiting = [waiting_ns for waiting_ns in self._waiting[-KEPT:]
                         if not self._join(waiting_ns)]

    def _join(self, stamp_ns: int) -> bool:
        """Make the line of sight of a frame, if all that it takes is there."""
        target, attitude = self._targets.at(stamp_ns), self._attitudes.at(stamp_ns)
        state = self.state_at(stamp_ns)
        if target is None or attitude is None or state is None or self.camera is None:
            return False
        (uv, sigma_px), (quaternion, covariance) = target, attitude
        seen = sight(self.camera, uv, sigma_px, quaternion, covariance, state.position_m,
                     state.covariance_m2)
        direction = seen.direction
        if self._options.aberration == 'stars_and_target':
            earth_m_s = earth_velocity_m_s(epoch_year_from_stamp(stamp_ns))
            direction = without_aberration(
                direction, state.velocity_m_s,
                boresight=rotate(quaternion, np.array([0.0, 0.0, 1.0])),
                stars_velocity_m_s=state.velocity_m_s + earth_m_s)
        elif self._options.aberration == 'target':
            direction = without_aberration(direction, state.velocity_m_s)
        self.sights.add(stamp_ns, TimedSight(
            Sight(seen.position_m, direction, seen.covariance), state.velocity_m_s))
        return True


def _mixed(begin: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """
    Return the covariance of an interpolated value, however the errors of both hang together.

    It is right for errors that are the same, and too large for independent ones.
    """
    return (1 - share) * begin + share * end
