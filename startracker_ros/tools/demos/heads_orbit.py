# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The motion of a body on which three heads are blinded in turn by Sun, Earth and Moon.

The boresights are 90 deg apart, and the body turns about the axis between them: all heads see the
same cone of the sky, a third of a turn after each other. The date, the axis and the orbit put
Sun, Moon and Earth beside that cone so that two heads see stars at any time.
"""

from datetime import datetime, UTC

import numpy as np
from startracker_ros.core.astro.bodies import bright_bodies
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, stamp_from_datetime
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_axes, quaternion_from_rotation_vector, rotate)
from startracker_ros.sim.sky.motion import SteadyMotion

START_NS = stamp_from_datetime(datetime(2026, 6, 9, 12, tzinfo=UTC))
TURN_S = 600.0
"""Of the body: the time of an orbit, accelerated."""

ALTITUDE_M = 20_200e3
MOUNTS = {f'tracker_{number}': quaternion_from_axes(
    np.array(z, float), np.roll(np.array(z, float), 1)) for number, z in enumerate(
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)), 1)}
"""q_body_from_sensor (4,) of the heads."""

_AXIS = np.ones(3) / np.sqrt(3)
_CONE_RAD = np.arccos(_AXIS[2])
# From the cone, and around it from the Sun.
_SUN_OFF, _MOON_OFF, _EARTH_OFF = np.radians([20.0, 4.0, 24.0])
_EARTH_FROM_SUN = np.radians(165.5)
_START_FROM_SUN = np.radians(69.0)


def body_motion() -> SteadyMotion:
    """Return the motion of the body from START_NS on."""
    bodies = bright_bodies(epoch_year_from_stamp(START_NS))
    sun = bodies['Sun'][0]
    axis = _axis(sun, bodies['Moon'][0])

    def around(angle: float) -> np.ndarray:
        return rotate(quaternion_from_rotation_vector(axis * angle), sun)
    outwards = around(_EARTH_FROM_SUN) - axis * (axis @ sun)
    outwards /= np.linalg.norm(outwards)
    earth_rad = _CONE_RAD + _EARTH_OFF
    zenith = -(np.cos(earth_rad) * axis + np.sin(earth_rad) * outwards)
    start = quaternion_from_axes(axis, around(_START_FROM_SUN))
    q_icrf_from_body = multiply(start, conjugate(quaternion_from_axes(_AXIS, np.eye(3)[2])))
    return SteadyMotion(q_icrf_from_body, 2 * np.pi / TURN_S * _AXIS, _orbit(zenith, axis))


def _axis(sun: np.ndarray, moon: np.ndarray) -> np.ndarray:
    """Return the axis (3,) of the cone, from which Sun and Moon are as far as they have to be."""
    cosines = np.cos(_CONE_RAD + np.array([_SUN_OFF, _MOON_OFF]))
    pair = np.array([sun, moon])
    within = pair.T @ np.linalg.solve(pair @ pair.T, cosines)
    normal = np.cross(sun, moon)
    return within + normal * np.sqrt(1 - within @ within) / np.linalg.norm(normal)


def _orbit(zenith: np.ndarray, axis: np.ndarray) -> CircularOrbit:
    """Return the orbit that passes a zenith (3,) at time 0, in a plane across the axis' one."""
    normal = np.cross(zenith, np.cross(axis, zenith))
    normal /= np.linalg.norm(normal)
    node = np.arctan2(normal[0], -normal[1])
    to_node = np.array([np.cos(node), np.sin(node), 0.0])
    latitude = np.arctan2(zenith @ np.cross(normal, to_node), zenith @ to_node)
    return CircularOrbit(EARTH_RADIUS_M + ALTITUDE_M, float(np.arccos(normal[2])), float(node),
                         float(latitude))
