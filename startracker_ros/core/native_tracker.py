# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A tracker of the native library with its sky, and what goes in and comes out of it."""

from io import BytesIO

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.astro.observer_motion import Observer, ObserverMotion
from startracker_ros.core.attitude.error_budget import ErrorBudget
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.star_file import star_arrays
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.native import aligned, NativeTracker
from startracker_ros.core.options import Options
from startracker_ros.core.stored_arrays import write_arrays

EXTRACTS, IDENTIFIES, TRACKS, TRUSTS = 1, 2, 4, 8
"""Stages, ST_EXTRACTS and so on."""

MOST_CENTROIDS = 5000
"""Capacity of lists of centroids, the brightest; what is not used takes no memory."""

_SKY = 'native_sky'
_ABERRATION = ('none', 'earth_only', 'full')
_UNKNOWN = np.full(3, np.nan)


class SkyTracker(NativeTracker):
    """
    A tracker that sees the stars of a catalogue as a moving observer, at rest without a motion.

    The stages of one frame may share it; each has a part of its config.
    """

    def __init__(self, config: np.ndarray, camera: Camera, onboard: OnboardCatalog,
                 motion: ObserverMotion | None,
                 patterns: tuple[np.ndarray, list[np.ndarray]] | None = None) -> None:
        super().__init__(config, camera.native, native_sky(onboard), patterns)
        self._motion = motion
        self._given: tuple[int, Observer] | None = None

    def look(self, stamp_ns: int) -> None:
        """Give the observer of a time, where it is not the one given last."""
        if self._motion is None:
            return
        observer, given = self._motion.at(stamp_ns), self._given
        if given is None or observer is not given[1] or stamp_ns < given[0]:
            self._given = stamp_ns, observer
            made = native_observer(observer)
            self.call('st_add_observer', stamp_ns, made.ctypes.data)

    def reset(self) -> None:
        """Forget all frames."""
        self.call('st_reset')
        self._given = None


# --- what goes in ---


def set_options(part: np.ndarray, options: Options, **choices: tuple[str, ...]) -> None:
    """Set a part of a CONFIG; of a choice the number among its names."""
    for name in part.dtype.names or ():
        if hasattr(options, name):
            value = getattr(options, name)
            part[name] = choices[name].index(value) if name in choices else value


def native_sky(onboard: OnboardCatalog) -> np.ndarray:
    """
    Return a sky file of a catalogue in memory, with its stars alone: no patterns, no pairs.

    It is made once for a catalogue.
    """
    made = vars(onboard)
    if _SKY not in made:
        file, had_grid = BytesIO(), 'grid' in made
        write_arrays(file, star_arrays(onboard))
        if not had_grid:
            # The file has it: eight megabytes of a whole sky.
            del made['grid']
        content = file.getbuffer()
        sky = aligned(len(content))
        sky[:] = np.frombuffer(content, np.uint8)
        # In a list: arrays are those of the stars.
        made[_SKY] = [sky]
    return made[_SKY][0]


def native_centroids(centroids: Centroids) -> np.ndarray:
    """Return a table (N,) of CENTROID as an array (N, 12), of MOST_CENTROIDS at most."""
    return np.ascontiguousarray(centroids.table()[:MOST_CENTROIDS])


def native_identified(hip: np.ndarray, count: int) -> np.ndarray:
    """Return a table (count,) of IDENTIFIED of the first of catalogue numbers hip (N,)."""
    table = np.zeros(count, native.IDENTIFIED)
    table['hip'] = np.asarray(hip)[:count]
    return table


def native_observer(observer: Observer) -> np.ndarray:
    """Return an OBSERVER."""
    made, state, bodies = np.zeros((), native.OBSERVER), observer.state, observer.bodies
    made['velocity_sigma_m_s'] = observer.velocity_sigma_m_s
    made['epoch_sigma_years'] = observer.epoch_sigma_years
    made['heliocentric_au'] = _UNKNOWN
    made['max_age_s'] = np.inf
    if state is not None:
        made['aberration'] = _ABERRATION.index(observer.used)
        made['velocity_m_s'] = state.velocity_m_s
        made['heliocentric_au'] = state.heliocentric_au
        if state.air is not None:
            made['zenith'] = state.air.zenith
            made['refraction_a_rad'], made['refraction_b_rad'] = state.air[1:]
    if bodies is not None:
        body = made['body'][:len(bodies.magnitude)]
        body['direction'], body['magnitude'] = bodies.direction, bodies.magnitude
        body['radius_rad'], body['error_rad'] = bodies.radius_rad, bodies.error_rad
        made['body_count'] = len(body)
    return made


# --- what comes out ---


def attitude_of(attitude: np.ndarray, budget: np.ndarray | None = None) -> AttitudeEstimate:
    """Return a valid ATTITUDE with its BUDGET, which it is a view of."""
    return AttitudeEstimate(
        attitude['quaternion'], attitude['covariance_rad2'], int(attitude['stars']),
        chi2=float(attitude['chi2']),
        budget=None if budget is None else ErrorBudget(*(
            budget[name] for name in ErrorBudget._fields)))
