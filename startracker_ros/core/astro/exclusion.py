# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When Sun, Moon or Earth are so near to the boresight that a head is blinded."""

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.bodies import bright_bodies
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.earth import EpochError
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.orbit import propagate
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.options import option, Options

HORIZON_S, STEP_S = 600.0, 5.0


@dataclass(frozen=True)
class ExclusionOptions(Options):
    """What blinds a head: angles between the boresight and the limb of a body."""

    sun_exclusion_deg: float = option(
        0.0, 'least angle between boresight and Sun; 0: the Sun is not looked for', unit='deg',
        low=0.0, high=180.0)
    moon_exclusion_deg: float = option(
        0.0, 'least angle between boresight and Moon; 0: the Moon is not looked for', unit='deg',
        low=0.0, high=180.0)
    earth_exclusion_deg: float = option(
        0.0, 'least angle between boresight and limb of the Earth, which needs odometry; 0: the '
        'Earth is not looked for', unit='deg', low=0.0, high=180.0)


class Blinding(NamedTuple):
    """
    What is to come within HORIZON_S.

    limb_deg are the angles of boresight and limb by body, now; negative within the disc. body is
    the first one to blind; in_s the time until it does, 0 now and infinity for none; return_s the
    time until nothing blinds any more, infinity where that is not within the horizon.
    """

    limb_deg: dict[str, float]
    body: str
    in_s: float
    return_s: float


class BlindingForecast:
    """Looks ahead at a constant body rate along the orbit."""

    def __init__(self, options: ExclusionOptions) -> None:
        self._exclusion_deg = {name: angle_deg for name, angle_deg in (
            ('Sun', options.sun_exclusion_deg), ('Moon', options.moon_exclusion_deg),
            ('Earth', options.earth_exclusion_deg)) if angle_deg}

    def at(self, stamp_ns: int, quaternion: np.ndarray, rate_rad_s: np.ndarray,
           state: State | None) -> Blinding | None:
        """
        Return what blinds a head of q_icrf_from_sensor (4,) and rate (3,) about sensor axes.

        state is that of the satellite, without which the Earth is left out and the Moon 1 deg off.
        None where nothing is looked for, or no ephemeris has the time.
        """
        if not self._exclusion_deg:
            return None
        time_s = np.arange(0.0, HORIZON_S + STEP_S, STEP_S)
        turns = quaternion_from_rotation_vector(rate_rad_s * time_s[:, None])
        boresight = matrix_from_quaternion(multiply(quaternion, turns))[:, :, 2]
        try:
            bodies = _bodies(stamp_ns, time_s, state)
        except EpochError:
            return None
        limb_deg = {}
        for name in self._exclusion_deg.keys() & bodies.keys():
            direction, radius_rad = bodies[name]
            cosine = np.clip(np.sum(boresight * direction, axis=1), -1, 1)
            limb_deg[name] = np.degrees(np.arccos(cosine) - radius_rad)
        return self._first(time_s, limb_deg)

    def _first(self, time_s: np.ndarray, limb_deg: dict[str, np.ndarray]) -> Blinding:
        """Return the first blinding of angles (T,) by body."""
        blinds = {name: angle < self._exclusion_deg[name] for name, angle in limb_deg.items()}
        now = {name: float(angle[0]) for name, angle in sorted(limb_deg.items())}
        blind = np.any([*blinds.values()], axis=0) if blinds else np.zeros(len(time_s), bool)
        if not blind.any():
            return Blinding(now, '', math.inf, math.inf)
        first = int(np.argmax(blind))
        after = np.flatnonzero(~blind[first:])
        body = next(name for name, mask in sorted(blinds.items()) if mask[first])
        return_s = math.inf
        if len(after):
            end = first + int(after[0])
            return_s = max(self._crossing_s(time_s, limb_deg, name, end)
                           for name, mask in blinds.items() if mask[end - 1])
        return Blinding(now, body, self._crossing_s(time_s, limb_deg, body, first), return_s)

    def _crossing_s(self, time_s: np.ndarray, limb_deg: dict[str, np.ndarray], name: str,
                    index: int) -> float:
        """Return when an angle (T,) is at its limit, between the steps before and at an index."""
        if not index:
            return 0.0
        before, after = limb_deg[name][index - 1:index + 1] - self._exclusion_deg[name]
        return float(time_s[index] - STEP_S * after / (after - before))


def _bodies(stamp_ns: int, time_s: np.ndarray, state: State | None
            ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return directions (T, 3) or (3,) and radii (T,) or () in rad by body."""
    if state is None:
        return {name: (direction, np.array(radius_rad)) for name, (direction, radius_rad)
                in bright_bodies(epoch_year_from_stamp(stamp_ns)).items()}
    position_m, velocity_m_s = state.position_m, state.velocity_m_s
    positions = []
    for step in range(len(time_s)):
        if step:
            position_m, velocity_m_s = propagate(position_m, velocity_m_s, STEP_S)
        positions.append(position_m)
    radius_m = np.linalg.norm(positions, axis=1)
    found = {'Earth': (-np.array(positions) / radius_m[:, None], np.arcsin(
        np.minimum(EARTH_RADIUS_M / radius_m, 1.0)))}
    ends = [bright_bodies(epoch_year_from_stamp(stamp_ns + round(time_s[index] * 1e9)),
                          positions[index]) for index in (0, -1)]
    share = (time_s / time_s[-1])[:, None]
    for name in ('Sun', 'Moon'):
        before, after = (end[name][0] for end in ends)
        direction = before + share * (after - before)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        found[name] = direction, np.full(len(time_s), ends[0][name][1])
    return found
