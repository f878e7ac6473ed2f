# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motion of the observer about the barycentre: what aberration is computed from."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.aberration import Air, ObserverState, state_near_earth
from startracker_ros.core.astro.bodies import bodies_at, BodiesInSky, STEP_NS
from startracker_ros.core.astro.constants import EARTH_RADIUS_M, MAX_SPEED_M_S
from startracker_ros.core.astro.earth import earth_state
from startracker_ros.core.astro.elements import orbit_velocity, OrbitOptions
from startracker_ros.core.astro.epoch import CatalogueEpoch, epoch_year_from_stamp, why_no_date
from startracker_ros.core.astro.orbit import OrbitError, propagate
from startracker_ros.core.astro.state import State
from startracker_ros.core.options import option

MAX_AGE_S = 600.0
"""Time for which odometry is propagated."""

LEAST_RADIUS_M = 6.3e6
"""The poles are at 6.357e6 m."""

ORBITING_M = EARTH_RADIUS_M + 120e3
"""Below it nothing is on an orbit: the velocity counts as constant."""

KNOWN_SIGMA_M_S = 20.0
"""1 sigma of a velocity out of odometry or elements per axis: 0.014 arcsec of aberration."""

ORBIT_SIGMA_M_S = 7.9e3 / np.sqrt(3)
"""1 sigma of an unknown velocity about the Earth per axis: rms of the lowest orbit's speed."""

EARTH_SIGMA_M_S = np.hypot(29.8e3, 7.9e3) / np.sqrt(3)
"""1 sigma per axis where the velocity of the Earth is unknown as well."""

_NO_ODOMETRY = 'no odometry'
_OTHER_EPOCH_YEARS = 5.0
"""Between stamps and an epoch that was given for them: one of both is wrong."""


@dataclass(frozen=True)
class AberrationOptions(OrbitOptions):
    """Which velocities aberration is corrected for."""

    aberration: str = option(
        'full', 'full: for the velocity of the Earth and that of the spacecraft, out of odometry '
        'or elements; where neither is usable as earth_only. earth_only: for that of the Earth; '
        'the covariance contains the 5 arcsec of a low orbit. none: a simulated sky without '
        'aberration', choices=('full', 'earth_only', 'none'))


class MotionError(ValueError):
    """Odometry that cannot be used; the text says why."""


class Observer(NamedTuple):
    """
    How the observer moves: state is None where aberration is not corrected.

    velocity_sigma_m_s is the 1 sigma of the unknown velocity per axis; used is full, earth_only
    or none, and reason why this is less than was requested, empty if it is not. trouble is
    whether the reason is an input that is wrong, and not just one that is not there. bodies are
    planets, Moon and Sun, None where the time is unknown. epoch_sigma_years is the 1 sigma of the
    epoch of the stars.
    """

    state: ObserverState | None
    velocity_sigma_m_s: float
    used: str
    reason: str = ''
    trouble: bool = False
    bodies: BodiesInSky | None = None
    epoch_sigma_years: float = 0.0

    @property
    def condition(self) -> str:
        """Return what aberration is corrected for, in words."""
        return f'{self.used} ({self.reason})' if self.reason else self.used


AT_REST = Observer(None, 0.0, 'none')


def observer_at(year: float, velocity_m_s: np.ndarray | None, air: Air | None = None
                ) -> Observer:
    """Return an observer of geocentric velocity (3,), None if it is unknown; EpochError."""
    observer_state = state_near_earth(
        year, np.zeros(3) if velocity_m_s is None else velocity_m_s)._replace(air=air)
    if velocity_m_s is None:
        return Observer(observer_state, ORBIT_SIGMA_M_S, 'earth_only')
    return Observer(observer_state, KNOWN_SIGMA_M_S, 'full')


class ObserverMotion:
    """
    The velocity of the observer at any stamp, from the newest odometry or from elements.

    epoch is that of the stars, None for that of the stamps.
    """

    def __init__(self, options: AberrationOptions = AberrationOptions(),
                 epoch: CatalogueEpoch | None = None) -> None:
        self._mode = options.aberration
        self._epoch = epoch
        self._newest: tuple[int, State] | None = None
        self._velocity, self._orbit_error = None, ''
        try:
            self._velocity = orbit_velocity(options)
        except OrbitError as error:
            self._orbit_error = str(error)
        self._last: tuple[int, Observer] | None = None
        self._propagated: tuple[int, State | None] | None = None
        self._seen: tuple[tuple[int, bool], BodiesInSky | None] | None = None

    def add_state(self, stamp_ns: int, state: State) -> None:
        """Use geocentric position and velocity on ICRF axes; MotionError if impossible."""
        speed_m_s, radius_m = map(np.linalg.norm, (state.velocity_m_s, state.position_m))
        if not speed_m_s <= MAX_SPEED_M_S:
            raise MotionError(f'{speed_m_s / 1e3:.1f} km/s about the Earth, '
                              f'{MAX_SPEED_M_S / 1e3:g} km/s are possible')
        if not radius_m >= LEAST_RADIUS_M:
            raise MotionError(f'position {radius_m / 1e3:.0f} km from the centre of the Earth')
        self._newest = stamp_ns, state
        self._last = self._propagated = None

    def at(self, stamp_ns: int) -> Observer:
        """Return the motion of the observer at a stamp."""
        # Without a velocity about the Earth it is the same until Earth and bodies have moved.
        moves = self._newest is not None or self._velocity is not None
        time = stamp_ns if moves else stamp_ns // STEP_NS
        if self._last is None or self._last[0] != time:
            observer = self._at(stamp_ns, self.why_no_date(stamp_ns))
            if self._epoch is not None:
                observer = observer._replace(epoch_sigma_years=self._epoch.sigma_years)
            self._last = time, observer
        return self._last[1]

    def why_no_date(self, stamp_ns: int) -> str:
        """Return why the date of a stamp is unknown, empty where it is known."""
        epoch = self._epoch
        # A simulation may begin at 0.
        no_date = why_no_date(stamp_ns or 1, '' if epoch is None else epoch.other_clock)
        if no_date or epoch is None or epoch.sigma_years:
            return no_date
        year = epoch_year_from_stamp(stamp_ns)
        if abs(year - epoch.year) > _OTHER_EPOCH_YEARS:
            return (f'stamps of {int(year)}, but the stars are of {epoch}: one of both is wrong, '
                    'or the driver stamps by another clock than UTC')
        return ''

    def geocentric(self, stamp_ns: int) -> State | None:
        """Return position and velocity out of odometry at a stamp, None if it has none."""
        if self._propagated is None or self._propagated[0] != stamp_ns:
            self._propagated = stamp_ns, self._geocentric(stamp_ns)
        return self._propagated[1]

    def _geocentric(self, stamp_ns: int) -> State | None:
        if self._newest is None or not abs(self._age_s(stamp_ns)) <= MAX_AGE_S:
            return None
        state = self._newest[1]
        if not state.position_m @ state.position_m > ORBITING_M ** 2:
            return state
        return State(*propagate(state.position_m, state.velocity_m_s, self._age_s(stamp_ns)),
                     state.covariance_m2)

    def _bodies(self, stamp_ns: int) -> BodiesInSky | None:
        """Return planets, Moon and Sun, from the position out of odometry where it is known."""
        step = stamp_ns // STEP_NS, self._newest is not None
        if self._seen is None or self._seen[0] != step:
            state = self.geocentric(stamp_ns)
            self._seen = step, bodies_at(stamp_ns, None if state is None else state.position_m)
        return self._seen[1]

    def _at(self, stamp_ns: int, no_date: str) -> Observer:
        bodies = None if no_date else self._bodies(stamp_ns)
        if self._mode == 'none':
            return AT_REST._replace(bodies=bodies)
        if no_date:
            return Observer(None, EARTH_SIGMA_M_S, 'none', no_date, True)
        heliocentric_au, earth_m_s = _earth(stamp_ns // STEP_NS)
        reason = ''
        if self._mode == 'full':
            velocity_m_s, reason = self._velocity_or_reason(stamp_ns)
            if velocity_m_s is not None:
                return Observer(ObserverState(earth_m_s + velocity_m_s, heliocentric_au),
                                KNOWN_SIGMA_M_S, 'full', bodies=bodies)
        return Observer(ObserverState(earth_m_s, heliocentric_au), ORBIT_SIGMA_M_S, 'earth_only',
                        reason, reason not in ('', _NO_ODOMETRY), bodies)

    def _velocity_or_reason(self, stamp_ns: int) -> tuple[np.ndarray | None, str]:
        """Return the geocentric velocity (3,), or None and why it is unknown."""
        state = self.geocentric(stamp_ns)
        if state is not None:
            return state.velocity_m_s, ''
        reason = (_NO_ODOMETRY if self._newest is None
                  else f'odometry is {abs(self._age_s(stamp_ns)) / 3600:.1f} h off')
        if self._velocity is not None:
            try:
                return self._velocity(stamp_ns), ''
            except OrbitError as error:
                return None, f'{reason}; {error}'
        return None, f'{reason}; {self._orbit_error}' if self._orbit_error else reason

    def _age_s(self, stamp_ns: int) -> float:
        assert self._newest is not None
        return (stamp_ns - self._newest[0]) * 1e-9


@lru_cache(maxsize=8)
def _earth(step: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return heliocentric position (3,) au and velocity (3,) m/s in the middle of a step.

    The velocity changes by 0.06 m/s in a step.
    """
    heliocentric_au, _, earth_m_s = earth_state(
        epoch_year_from_stamp(step * STEP_NS + STEP_NS // 2))
    return heliocentric_au, earth_m_s
