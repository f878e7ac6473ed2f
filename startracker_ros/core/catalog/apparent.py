"""The on-board catalogue as a moving observer sees it."""

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions
from startracker_ros.core.astro.observer_motion import AT_REST, Observer
from startracker_ros.core.catalog.onboard import CROWD_MAGNITUDES, OnboardCatalog
from startracker_ros.core.compiled import compiled

_TOLERANCE_M_S = 1.5
"""Change of velocity that is ignored: 0.001 arcsec of aberration."""


class ApparentCatalog:
    """
    Apparent directions of catalogue entries, computed when they are needed.

    An attitude that is fitted to them is that of the sensor in ICRF, on GCRS axes. observer is
    the one of the last look_from().
    """

    def __init__(self, onboard: OnboardCatalog) -> None:
        self.onboard = onboard
        self.observer = AT_REST
        self._vantage = AT_REST.vantage
        self._direction = onboard.direction
        self._computed = np.empty(0, bool)
        self.version = 0
        self._bodies = AT_REST.bodies
        self._crowded, self._compared = onboard.crowded, np.empty(0, bool)

    def look_from(self, observer: Observer) -> None:
        """Set the observer; version changes with the directions."""
        self.observer = observer
        if observer.bodies is not self._bodies:
            self._bodies = observer.bodies
            self._crowded = self.onboard.crowded.copy()
            self._compared = np.zeros(len(self.onboard), bool)
        before, after = self._vantage, observer.vantage
        if after is before:
            return
        if before is not None and after is not None:
            change_m_s = after.velocity_m_s - before.velocity_m_s
            if change_m_s @ change_m_s < _TOLERANCE_M_S ** 2:
                return
        self._vantage = after
        self.version += 1
        if after is None:
            self._direction = self.onboard.direction
        else:
            if before is None:
                self._direction = np.empty_like(self.onboard.direction)
            self._computed = np.zeros(len(self.onboard), bool)

    def direction(self, star_index: np.ndarray) -> np.ndarray:
        """Return the apparent unit vectors (M, 3) of entries (M,)."""
        if self._vantage is not None:
            missing = _missing(self._computed, star_index)
            if len(missing):
                self._computed[missing] = True
                self._direction[missing] = apparent_directions(
                    self.onboard.direction[missing], self._vantage)
        return self._direction.take(star_index, axis=0)

    def crowded(self, star_index: np.ndarray) -> np.ndarray:
        """Return which entries (M,) are blended: with a neighbour, a planet, the Moon, the Sun."""
        if self._bodies is not None:
            missing = star_index[~self._compared[star_index]]
            if len(missing):
                onboard = self.onboard
                near = self._bodies.near(onboard.direction[missing], onboard.magnitude[missing],
                                         onboard.crowd_rad, CROWD_MAGNITUDES)
                self._crowded[missing] |= near.any(axis=1)
                self._compared[missing] = True
        return self._crowded[star_index]


@compiled
def _missing(computed: np.ndarray, star_index: np.ndarray) -> np.ndarray:
    """Return which of entries (M,) are not computed."""
    missing, count = np.empty(len(star_index), np.int64), 0
    for star in star_index:
        if not computed[star]:
            missing[count] = star
            count += 1
    return missing[:count]
