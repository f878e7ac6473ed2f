# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sun, Moon and Earth before the boresight: now, and when the body turns or goes on."""

import math

import numpy as np
import pytest
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.exclusion import BlindingForecast, ExclusionOptions, HORIZON_S
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import quaternion_from_axes

STAMP_NS = 1_790_000_000_000_000_000
REST = np.zeros(3)


def towards(direction, off_deg):
    """Return a boresight so far from a direction, and the sensor axis that turns it there."""
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = math.radians(off_deg)
    boresight = math.cos(angle) * direction + math.sin(angle) * side
    # y of the sensor is along boresight x side: a positive rate moves z towards x.
    return quaternion_from_axes(boresight, np.cross(boresight, side))


def body(name, position_m=None):
    sky = bodies_from_earth(epoch_year_from_stamp(STAMP_NS), position_m)
    return sky.direction[BODIES.index(name)], sky.radius_rad[BODIES.index(name)]


def test_the_sun_ahead_of_a_turn_and_after_it():
    direction, radius_rad = body('Sun')
    forecast = BlindingForecast(ExclusionOptions(sun_exclusion_deg=30.0))
    # Through the Sun at 0.5 deg/s: 30 deg before its limb, and 30 deg behind it.
    found = [forecast.at(STAMP_NS, towards(direction, 40.0), np.radians([0, rate, 0]), None)
             for rate in (0.5, -0.5)]
    ahead = min(found, key=lambda one: one.in_s)
    away = max(found, key=lambda one: one.in_s)
    limb_deg = 40.0 - math.degrees(radius_rad)
    assert ahead.limb_deg == pytest.approx({'Sun': limb_deg}, abs=1e-6)
    assert ahead.body == 'Sun'
    assert ahead.in_s == pytest.approx((limb_deg - 30) / 0.5, abs=0.02)
    assert ahead.return_s == pytest.approx(
        (limb_deg - 30 + 2 * (30 + math.degrees(radius_rad))) / 0.5, abs=0.02)
    # The other way round it is reached after 360 deg only.
    assert (away.body, away.in_s) == ('', math.inf) or away.in_s > 500


def test_what_blinds_now():
    direction, _ = body('Moon')
    blinding = BlindingForecast(ExclusionOptions(moon_exclusion_deg=10.0)).at(
        STAMP_NS, towards(direction, 5.0), REST, None)
    assert (blinding.body, blinding.in_s, blinding.return_s) == ('Moon', 0.0, math.inf)
    assert BlindingForecast(ExclusionOptions()).at(
        STAMP_NS, towards(direction, 5.0), REST, None) is None


def test_the_earth_comes_along_the_orbit():
    orbit = CircularOrbit(EARTH_RADIUS_M + 700e3, 0.5, 1.0, 0.3)
    position_m, velocity_m_s = orbit.at(0.0)
    state = State(position_m, velocity_m_s, np.eye(3))
    nadir = -position_m / np.linalg.norm(position_m)
    ahead = velocity_m_s / np.linalg.norm(velocity_m_s)
    radius_deg = math.degrees(math.asin(EARTH_RADIUS_M / np.linalg.norm(position_m)))
    # A boresight at rest in the orbital plane, towards which the Earth moves.
    angle = math.radians(radius_deg + 50.0)
    boresights = [math.cos(angle) * nadir + sign * math.sin(angle) * ahead for sign in (1, -1)]
    forecast = BlindingForecast(ExclusionOptions(earth_exclusion_deg=20.0))
    found = [forecast.at(STAMP_NS, quaternion_from_axes(b, orbit.normal), REST, state)
             for b in boresights]
    for blinding in found:
        assert blinding.limb_deg['Earth'] == pytest.approx(50.0, abs=1e-6)
    in_s = min(blinding.in_s for blinding in found)
    expected_s = math.radians(30.0) / orbit.rate_rad_s
    # The orbit of the forecast has J2.
    assert expected_s < HORIZON_S and abs(in_s - expected_s) < 0.5
    # Without the orbit nothing is known of the Earth.
    assert forecast.at(STAMP_NS, towards(nadir, 5.0), REST, None).limb_deg == {}


def test_outside_of_the_ephemeris_nothing_is_said():
    forecast = BlindingForecast(ExclusionOptions(sun_exclusion_deg=30.0))
    assert forecast.at(6_000_000_000_000_000_000, towards(np.array([1.0, 0, 0]), 5.0), REST,
                       None) is None
