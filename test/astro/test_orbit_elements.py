"""Elements, propagation and the orbit frame, beside Skyfield and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from skyfield.api import load
from skyfield.elementslib import OsculatingElements
from skyfield.units import Distance, Velocity
from startracker_ros.astro.constants import EARTH_J2, EARTH_MU_M3_S2, EARTH_RADIUS_M
from startracker_ros.astro.orbit import (
    Elements, elements_from_state, orbit_frame, OrbitError, propagate, state_from_elements)

ELEMENTS = Elements(7.3e6, 0.03, *np.radians([51.0, 250.0, 310.0, 75.0]))


def values(elements):
    return np.array([elements.semi_major_axis_m, elements.eccentricity, elements.inclination_rad,
                     elements.node_rad, elements.perigee_rad, elements.true_anomaly_rad])


def test_elements_are_those_of_skyfield():
    position, velocity = state_from_elements(ELEMENTS)
    theirs = OsculatingElements(
        Distance(km=position / 1e3), Velocity(km_per_s=velocity / 1e3),
        load.timescale(builtin=True).tt(2026), EARTH_MU_M3_S2 / 1e9)
    for ours, other in ((ELEMENTS.semi_major_axis_m / 1e3, theirs.semi_major_axis.km),
                        (ELEMENTS.eccentricity, theirs.eccentricity),
                        (ELEMENTS.inclination_rad, theirs.inclination.radians),
                        (ELEMENTS.node_rad, theirs.longitude_of_ascending_node.radians),
                        (ELEMENTS.perigee_rad, theirs.argument_of_periapsis.radians),
                        (ELEMENTS.true_anomaly_rad, theirs.true_anomaly.radians)):
        assert ours == pytest.approx(other, rel=1e-9)


@pytest.mark.parametrize('elements', [
    ELEMENTS,
    Elements(8e6, 0.1, 0.0, 0.0, 1.0, 4.0),
    Elements(8e6, 0.0, 1.2, 2.0, 0.0, 3.0),
    Elements(42.164e6, 0.0, 0.0, 0.0, 0.0, 5.0),
    Elements(2e7, 0.6, 2.9, 6.0, 3.0, 0.1)])
def test_to_state_and_back(elements):
    np.testing.assert_allclose(values(elements_from_state(*state_from_elements(elements))),
                               values(elements), rtol=1e-10, atol=1e-10)


def test_no_closed_orbit_is_refused():
    with pytest.raises(OrbitError, match='no closed orbit'):
        elements_from_state(np.array([7e6, 0, 0]), np.array([0, 12e3, 0.0]))
    with pytest.raises(OrbitError, match='no closed orbit'):
        elements_from_state(np.array([7e6, 0, 0]), np.array([3e3, 0, 0.0]))
    with pytest.raises(OrbitError, match='eccentricity 1.2'):
        state_from_elements(Elements(7e6, 1.2, 0, 0, 0, 0))


def test_two_body_motion_returns_after_a_period():
    position, velocity = state_from_elements(ELEMENTS)
    period_s = 2 * np.pi * np.sqrt(ELEMENTS.semi_major_axis_m ** 3 / EARTH_MU_M3_S2)
    back, _ = propagate(position, velocity, period_s, j2=0.0)
    np.testing.assert_allclose(back, position, atol=5e-3)
    half, half_speed = propagate(position, velocity, -period_s / 3, j2=0.0)
    np.testing.assert_allclose(values(elements_from_state(half, half_speed))[:5],
                               values(ELEMENTS)[:5], rtol=1e-8)


def test_j2_motion_follows_the_gradient_of_the_potential():
    """The potential is written down anew, its gradient taken numerically, SciPy integrates."""
    def potential(place):
        radius = np.linalg.norm(place)
        sine = place[2] / radius
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


def test_orbit_frame():
    position, velocity = state_from_elements(Elements(7e6, 0.0, 0.4, 1.0, 0.0, 2.0))
    frame = orbit_frame(position, velocity)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_allclose(frame[:, 2], -position / 7e6, atol=1e-12)
    np.testing.assert_allclose(frame[:, 0], velocity / np.linalg.norm(velocity), atol=1e-14)
    many = orbit_frame(np.stack([position, -position]), np.stack([velocity, velocity]))
    np.testing.assert_allclose(many[0], frame)
