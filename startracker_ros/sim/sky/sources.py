# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Light sources in and around the field of view: stars, planets, satellites."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.astro.bodies import bodies_from_earth, PLANETS
from startracker_ros.core.astro.constants import YEAR_S
from startracker_ros.core.astro.earth import earth_position_au, in_range
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.motion_state import Motion, MotionState
from startracker_ros.sim.sky.target import Target


@dataclass(frozen=True)
class SceneStars:
    """
    The light sources in an image, catalogue stars first, brightest first.

    hip (N,) int32, 0 for planets, satellites and false stars; uv (N, 2) in px; magnitude (N,)
    V. Close pairs are separate entries whose images blend on the detector.
    """

    hip: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def select(self, index: np.ndarray) -> 'SceneStars':
        """Return the stars of a boolean mask (N,) or of indices."""
        return SceneStars(self.hip[index], self.uv[index], self.magnitude[index])

    def joined(self, other: 'SceneStars') -> 'SceneStars':
        """Return these stars and those of another scene."""
        return SceneStars(np.append(self.hip, other.hip), np.vstack([self.uv, other.uv]),
                          np.append(self.magnitude, other.magnitude))


def false_stars(uv: np.ndarray, magnitude: np.ndarray) -> SceneStars:
    """Return sources at uv (N, 2) px of V magnitude (N,) that are not catalogue stars."""
    return SceneStars(np.zeros(len(uv), np.int32), uv, magnitude)


@dataclass(frozen=True)
class SkyOptions(Options):
    """Aberration, and light sources besides the catalogue stars."""

    aberration: bool = option(
        True, 'stellar aberration by the velocity of the orbit and of the Earth, and light '
        'deflection by the Sun')
    planets: bool = option(False, 'Mercury to Neptune at their positions of date')
    satellites: int = option(0, 'number of satellites near the field', low=0, high=100)
    satellite_rate_deg_s: float = option(0.5, 'angular rate of the satellites among the stars',
                                         unit='deg/s', low=1e-4, high=20.0)
    satellite_magnitude: float = option(3.0, 'V of the satellites', unit='mag',
                                        low=-10.0, high=15.0)


@dataclass(frozen=True)
class LightSources:
    """
    Point sources as an observer sees them at one instant.

    hip (N,) int32, 0 for planets and satellites; direction (N, 3) on ICRF axes; drift_rad_s
    (N, 3), its rate among the stars; magnitude (N,) V.
    """

    hip: np.ndarray
    direction: np.ndarray
    drift_rad_s: np.ndarray
    magnitude: np.ndarray


class Sky:
    """Finds the light sources around the boresight of a moving observer."""

    def __init__(self, catalog: StarCatalog, epoch_year: float, motion: Motion,
                 field_rad: float, options: SkyOptions = SkyOptions(), *,
                 target: Target | None = None, seed: int = 0) -> None:
        """Time counts from epoch_year; field_rad is the angle from boresight to corner."""
        self._target = target
        self._catalog = catalog
        self._directions = catalog.directions(epoch_year, earth_position_au(epoch_year))
        self._epoch_year = epoch_year
        self._options = options
        self._satellites = SatelliteTraffic(
            options.satellites, np.radians(options.satellite_rate_deg_s), field_rad, motion, seed)

    def around(self, state: MotionState, time_s: float,
               radius_rad: float) -> tuple[LightSources, ...]:
        """
        Return the sources within radius_rad of the boresight, and all false stars.

        The first group is fixed among the stars, the second moves.
        """
        options = self._options
        year = self._epoch_year + time_s / YEAR_S
        boresight = rotate(state.q_icrf_from_sensor, np.array([0.0, 0.0, 1.0]))
        near = np.flatnonzero(self._directions @ boresight >= np.cos(radius_rad))
        hip, direction = self._catalog.hip[near], self._directions[near]
        magnitude = self._catalog.magnitude[near]
        if options.planets and in_range(year):
            planets, planet_magnitude = (
                column[:len(PLANETS)] for column in bodies_from_earth(year)[:2])
            hip = np.concatenate([hip, np.zeros(len(planets), hip.dtype)])
            direction = np.concatenate([direction, planets])
            magnitude = np.concatenate([magnitude, planet_magnitude])
        if options.aberration and in_range(year):
            direction = apparent_directions(
                direction, state_near_earth(year, state.velocity_m_s))
        still = LightSources(hip, direction, np.zeros_like(direction), magnitude)
        moving = self._moving(state, time_s)
        return (still, moving) if len(moving.hip) else (still,)

    def _moving(self, state: MotionState, time_s: float) -> LightSources:
        """Return the satellites and, if visible, the target."""
        options = self._options
        direction, drift_rad_s = self._satellites.at(time_s)
        magnitude = np.full(options.satellites, options.satellite_magnitude)
        view = None if self._target is None else self._target.seen_from(
            state, time_s, aberration=options.aberration)
        if view is not None:
            direction = np.vstack([direction, view.direction])
            drift_rad_s = np.vstack([drift_rad_s, view.drift_rad_s])
            magnitude = np.append(magnitude, view.magnitude)
        return LightSources(np.zeros(len(magnitude), self._catalog.hip.dtype), direction,
                            drift_rad_s, magnitude)


@dataclass(frozen=True)
class SatelliteTraffic:
    """
    A constant number of satellites near the field, each on a great circle of its own.

    When one has crossed the field, a new one enters from a random direction. Each passes within
    half field_rad of the boresight, at rate_rad_s among the stars.
    """

    count: int
    rate_rad_s: float
    field_rad: float
    motion: Motion
    seed: int

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return unit vectors (count, 3) on ICRF axes and their rates (count, 3) in rad/s."""
        states = [self._passing(index, time_s) for index in range(self.count)]
        direction, drift = np.reshape(states, (self.count, 2, 3)).swapaxes(0, 1)
        return direction, drift

    def _passing(self, index: int, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        duration_s = 2 * self.field_rad / self.rate_rad_s
        # The satellites are evenly spaced in time.
        number, phase = divmod(time_s / duration_s + index / self.count, 1)
        since_s = (phase - 0.5) * duration_s
        rng = np.random.default_rng(np.random.SeedSequence(
            self.seed, spawn_key=(index, int(number) % 2 ** 32)))
        course, miss = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5) * self.field_rad
        q = self.motion.at(time_s - since_s).q_icrf_from_sensor
        heading, aside, ahead = rotate(q, np.array([
            [np.cos(course), np.sin(course), 0.0], [-np.sin(course), np.cos(course), 0.0],
            [0.0, 0.0, 1.0]]))
        nearest = np.cos(miss) * ahead + np.sin(miss) * aside
        angle = self.rate_rad_s * since_s
        return (np.cos(angle) * nearest + np.sin(angle) * heading,
                self.rate_rad_s * (np.cos(angle) * heading - np.sin(angle) * nearest))
