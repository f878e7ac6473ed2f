# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Elements, circular orbits, J2 motion and the orbit frame, against Skyfield and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from skyfield.api import load
from skyfield.elementslib import OsculatingElements
from skyfield.units import Distance, Velocity
from startracker_ros.core.astro.constants import EARTH_J2, EARTH_MU_M3_S2, EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import (
    CircularOrbit, Elements, orbit_frame, OrbitError, propagate, state_from_elements)

ELEMENTS = Elements(7.3e6, 0.03, *np.radians([51.0, 250.0, 310.0, 75.0]))
ORBIT = CircularOrbit(EARTH_RADIUS_M + 700e3, *np.radians([30.0, 50.0, 20.0]))


def skyfield_elements(position, velocity):
    return OsculatingElements(
        Distance(km=position / 1e3), Velocity(km_per_s=velocity / 1e3),
        load.timescale(builtin=True).tt(2026), EARTH_MU_M3_S2 / 1e9)


def test_elements_agree_with_skyfield():
    theirs = skyfield_elements(*state_from_elements(ELEMENTS))
    for ours, other in ((ELEMENTS.semi_major_axis_m / 1e3, theirs.semi_major_axis.km),
                        (ELEMENTS.eccentricity, theirs.eccentricity),
                        (ELEMENTS.inclination_rad, theirs.inclination.radians),
                        (ELEMENTS.node_rad, theirs.longitude_of_ascending_node.radians),
                        (ELEMENTS.perigee_rad, theirs.argument_of_periapsis.radians),
                        (ELEMENTS.true_anomaly_rad, theirs.true_anomaly.radians)):
        assert ours == pytest.approx(other, rel=1e-9)


def test_open_orbits_are_rejected():
    with pytest.raises(OrbitError, match='no closed orbit'):
        state_from_elements(Elements(-7e6, 0.5, 0, 0, 0, 0))
    with pytest.raises(OrbitError, match='eccentricity 1.2'):
        state_from_elements(Elements(7e6, 1.2, 0, 0, 0, 0))


def test_two_body_motion_returns_after_a_period():
    position, velocity = state_from_elements(ELEMENTS)
    period_s = 2 * np.pi * np.sqrt(ELEMENTS.semi_major_axis_m ** 3 / EARTH_MU_M3_S2)
    back, _ = propagate(position, velocity, period_s, j2=0.0)
    np.testing.assert_allclose(back, position, atol=5e-3)
    part, part_velocity = propagate(position, velocity, -period_s / 3, j2=0.0)
    theirs = skyfield_elements(part, part_velocity)
    assert theirs.semi_major_axis.km * 1e3 == pytest.approx(ELEMENTS.semi_major_axis_m, rel=1e-8)
    assert theirs.eccentricity == pytest.approx(ELEMENTS.eccentricity, rel=1e-7)
    assert theirs.argument_of_periapsis.radians == pytest.approx(ELEMENTS.perigee_rad, rel=1e-7)


def test_j2_motion_follows_the_gradient_of_the_potential():
    """Numerical gradient of an independent potential, integrated by SciPy."""
    def potential(position):
        radius = np.linalg.norm(position)
        sine = position[2] / radius
        return EARTH_MU_M3_S2 / radius * (
            1 - EARTH_J2 * (EARTH_RADIUS_M / radius) ** 2 * (3 * sine ** 2 - 1) / 2)

    def slope(_, state):
        step = 50 * np.eye(3)
        pull = [(potential(state[:3] + h) - potential(state[:3] - h)) / 100 for h in step]
        return np.concatenate([state[3:], pull])
    position, velocity = state_from_elements(ELEMENTS)
    theirs = solve_ivp(slope, (0, 1800), np.concatenate([position, velocity]), method='DOP853',
                       rtol=1e-11, atol=1e-4).y[:, -1]
    ours = propagate(position, velocity, 1800.0)
    np.testing.assert_allclose(ours[0], theirs[:3], atol=0.05)
    assert np.linalg.norm(propagate(position, velocity, 1800.0, j2=0.0)[0] - ours[0]) > 1e3


def test_period_of_a_known_altitude():
    # 98.77 min at 700 km is the textbook figure (Vallado, Fundamentals of Astrodynamics).
    period_s = 2 * np.pi / ORBIT.rate_rad_s
    assert period_s / 60 == pytest.approx(98.77, abs=0.01)
    np.testing.assert_allclose(ORBIT.at(period_s)[0], ORBIT.at(0.0)[0], atol=1e-6)


@pytest.mark.parametrize('time_s', [0.0, 1234.5, -777.0])
def test_circular_orbit_obeys_gravity(time_s):
    step = 0.01
    (before, v_before), (after, v_after) = ORBIT.at(time_s - step), ORBIT.at(time_s + step)
    position, velocity = ORBIT.at(time_s)
    np.testing.assert_allclose((after - before) / (2 * step), velocity, atol=1e-4)
    gravity = -EARTH_MU_M3_S2 * position / np.linalg.norm(position) ** 3
    np.testing.assert_allclose((v_after - v_before) / (2 * step), gravity, atol=1e-6)
    assert np.linalg.norm(position) == pytest.approx(ORBIT.radius_m, rel=1e-14)


def test_plane_and_direction_of_motion():
    position, velocity = ORBIT.at(321.0)
    momentum = np.cross(position, velocity)
    np.testing.assert_allclose(momentum / np.linalg.norm(momentum), ORBIT.normal, atol=1e-14)
    assert np.degrees(np.arccos(ORBIT.normal[2])) == pytest.approx(30.0)
    at_node = CircularOrbit(7e6, *np.radians([30.0, 50.0, 0.0]))
    position, velocity = at_node.at(0.0)
    np.testing.assert_allclose(position, 7e6 * np.array(
        [np.cos(at_node.node_rad), np.sin(at_node.node_rad), 0.0]), atol=1e-8)
    assert velocity[2] > 0


def test_orbit_frame():
    position, velocity = state_from_elements(Elements(7e6, 0.0, 0.4, 1.0, 0.0, 2.0))
    frame = orbit_frame(position, velocity)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_allclose(frame[:, 2], -position / 7e6, atol=1e-12)
    np.testing.assert_allclose(frame[:, 0], velocity / np.linalg.norm(velocity), atol=1e-14)
    many = orbit_frame(np.stack([position, -position]), np.stack([velocity, velocity]))
    np.testing.assert_allclose(many[0], frame)
