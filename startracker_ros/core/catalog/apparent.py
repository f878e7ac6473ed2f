# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The on-board catalogue as a moving observer sees it."""

from copy import copy

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions, ObserverState
from startracker_ros.core.astro.bodies import BodiesInSky
from startracker_ros.core.astro.observer_motion import AT_REST, Observer, ObserverMotion
from startracker_ros.core.catalog.onboard import CROWD_MAGNITUDES, OnboardCatalog

_TOLERANCE_M_S = 1.5
"""Change of velocity that is ignored: 0.001 arcsec of aberration."""


class ApparentCatalog:
    """
    Apparent directions of catalogue entries for one observer, computed when they are needed.

    An attitude that is fitted to them is that of the sensor in ICRF, on GCRS axes. version is the
    same object as long as the directions are the same.
    """

    def __init__(self, onboard: OnboardCatalog, observer: Observer = AT_REST) -> None:
        self.onboard, self.observer = onboard, observer
        self._directions = _Directions(onboard, observer.state)
        self._crowding = _Crowding(onboard, observer.bodies)

    def seen_by(self, observer: Observer) -> 'ApparentCatalog':
        """Return the catalogue for another observer; what is the same is not computed again."""
        if observer is self.observer:
            return self
        seen = copy(self)
        seen.observer = observer
        if not self._directions.hold_for(observer.state):
            seen._directions = _Directions(self.onboard, observer.state)
        if observer.bodies is not self._crowding.bodies:
            seen._crowding = _Crowding(self.onboard, observer.bodies)
        return seen

    @property
    def version(self) -> object:
        """Return an object that stands for the directions."""
        return self._directions

    def direction(self, star_index: np.ndarray) -> np.ndarray:
        """Return the apparent unit vectors (M, 3) of entries (M,)."""
        return self._directions.of(star_index)

    def motion(self, star_index: np.ndarray) -> np.ndarray | None:
        """Return the proper motions (M, 3) of entries (M,) in rad a year, None if not known."""
        motion = self.onboard.motion
        return None if motion is None else motion[star_index]

    def crowded(self, star_index: np.ndarray) -> np.ndarray:
        """Return which entries (M,) are blended: with a neighbour, a planet, the Moon, the Sun."""
        return self._crowding.of(star_index)


class ApparentSky:
    """The on-board catalogue as a moving observer sees it, at rest without a motion."""

    def __init__(self, onboard: OnboardCatalog, motion: ObserverMotion | None = None) -> None:
        self.onboard = onboard
        self._motion = motion
        self._newest = ApparentCatalog(onboard)

    def at(self, stamp_ns: int) -> ApparentCatalog:
        """Return the catalogue for the observer of a stamp."""
        if self._motion is not None:
            self._newest = self._newest.seen_by(self._motion.at(stamp_ns))
        return self._newest


class _Directions:
    """The directions that were computed for a state of the observer."""

    def __init__(self, onboard: OnboardCatalog, observer_state: ObserverState | None) -> None:
        self._onboard, self._observer_state = onboard, observer_state
        self._direction = onboard.direction
        if observer_state is not None:
            self._direction = np.empty_like(onboard.direction)
            self._computed = np.zeros(len(onboard), bool)

    def hold_for(self, observer_state: ObserverState | None) -> bool:
        """Return whether the directions of another state are the same."""
        own = self._observer_state
        if own is None or observer_state is None:
            return own is observer_state
        change_m_s = observer_state.velocity_m_s - own.velocity_m_s
        return bool(change_m_s @ change_m_s < _TOLERANCE_M_S ** 2)

    def of(self, star_index: np.ndarray) -> np.ndarray:
        if self._observer_state is not None:
            missing = star_index[~self._computed[star_index]]
            if len(missing):
                self._computed[missing] = True
                self._direction[missing] = apparent_directions(
                    self._onboard.direction[missing], self._observer_state)
        return self._direction.take(star_index, axis=0)


class _Crowding:
    """Which entries were compared with planets, Moon and Sun, and which are blended."""

    def __init__(self, onboard: OnboardCatalog, bodies: BodiesInSky | None) -> None:
        self._onboard, self.bodies = onboard, bodies
        self._crowded = onboard.crowded
        if bodies is not None:
            self._crowded = onboard.crowded.copy()
            self._compared = np.zeros(len(onboard), bool)

    def of(self, star_index: np.ndarray) -> np.ndarray:
        if self.bodies is not None:
            missing = star_index[~self._compared[star_index]]
            if len(missing):
                onboard = self._onboard
                near = self.bodies.near(onboard.direction[missing], onboard.magnitude[missing],
                                        onboard.crowd_rad, CROWD_MAGNITUDES)
                self._crowded[missing] |= near.any(axis=1)
                self._compared[missing] = True
        return self._crowded[star_index]
