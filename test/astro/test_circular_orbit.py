"""Circular orbits obey gravity."""

import numpy as np
import pytest
from startracker_ros.astro.circular_orbit import CircularOrbit
from startracker_ros.astro.constants import EARTH_MU_M3_S2, EARTH_RADIUS_M

ORBIT = CircularOrbit(EARTH_RADIUS_M + 700e3, *np.radians([30.0, 50.0, 20.0]))


def test_period_of_a_known_altitude():
    # 98.77 min at 700 km is the textbook figure (Vallado, Fundamentals of Astrodynamics).
    assert ORBIT.period_s / 60 == pytest.approx(98.77, abs=0.01)
    np.testing.assert_allclose(ORBIT.at(ORBIT.period_s)[0], ORBIT.at(0.0)[0], atol=1e-6)


@pytest.mark.parametrize('time_s', [0.0, 1234.5, -777.0])
def test_velocity_and_acceleration_are_those_of_gravity(time_s):
    step = 0.01
    (before, v_before), (after, v_after) = ORBIT.at(time_s - step), ORBIT.at(time_s + step)
    position, velocity = ORBIT.at(time_s)
    np.testing.assert_allclose((after - before) / (2 * step), velocity, atol=1e-4)
    gravity = -EARTH_MU_M3_S2 * position / np.linalg.norm(position) ** 3
    np.testing.assert_allclose((v_after - v_before) / (2 * step), gravity, atol=1e-6)
    assert np.linalg.norm(position) == pytest.approx(ORBIT.radius_m, rel=1e-14)


def test_plane_and_sense_of_motion():
    position, velocity = ORBIT.at(321.0)
    momentum = np.cross(position, velocity)
    np.testing.assert_allclose(momentum / np.linalg.norm(momentum), ORBIT.normal, atol=1e-14)
    assert np.degrees(np.arccos(ORBIT.normal[2])) == pytest.approx(30.0)
    at_node = CircularOrbit(7e6, *np.radians([30.0, 50.0, 0.0]))
    position, velocity = at_node.at(0.0)
    np.testing.assert_allclose(position, 7e6 * at_node.node, atol=1e-8)
    assert velocity[2] > 0
