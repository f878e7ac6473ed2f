# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Earth velocity, apparent directions and orbits against astropy and Skyfield."""

from datetime import datetime, UTC

from astropy import units
from astropy.coordinates import GCRS, get_body_barycentric_posvel, SkyCoord
from astropy.time import Time
import numpy as np
import pytest
from skyfield.api import EarthSatellite, load
from startracker_ros.core.astro.aberration import (
    aberrate, apparent_directions, natural_directions, state_near_earth)
from startracker_ros.core.astro.earth import (
    earth_position_au, earth_state, earth_velocity_m_s, EpochError)
from startracker_ros.core.astro.elements import KeplerOrbit, TwoLineOrbit
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, stamp_from_epoch_year
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.astro.orbit import Elements, OrbitError, state_from_elements
from startracker_ros.core.maths.rotation import ARCSEC

# The International Space Station, out of the documentation of sgp4.
TLE = ('1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991',
       '2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482')

EPOCH_NS = 1_575_909_509 * 10 ** 9


@pytest.fixture
def directions():
    """Return unit vectors (200, 3) all over the sky."""
    vectors = np.random.default_rng(1).standard_normal((200, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.mark.parametrize('year', [1900.0, 1950.3, 1991.25, 2026.7, 2050.1, 2100.0])
def test_the_earth_is_where_astropy_has_it(year):
    time = Time(year, format='jyear', scale='tdb')
    position, velocity = get_body_barycentric_posvel('earth', time, ephemeris='builtin')
    assert np.linalg.norm(earth_position_au(year) - position.xyz.to_value('au')) < 1e-9
    assert np.linalg.norm(
        earth_velocity_m_s(year) - velocity.xyz.to_value('m/s')) < 1e-3


@pytest.mark.parametrize('year', [1899.9, 2100.1, 2500.0, float('nan')])
def test_epochs_without_a_series_are_named(year):
    with pytest.raises(EpochError, match='is outside 1900-2100'):
        earth_state(year)
    assert not earth_position_au(year).any()


@pytest.mark.parametrize('year', [1991.4, 2010.0, 2026.3, 2049.8])
def test_apparent_directions_are_those_of_astropy(directions, year):
    """Aberration of Earth and spacecraft with light deflection, far from the Sun."""
    velocity_m_s = np.array([3000.0, -6000.0, 4000.0])
    time = Time(year, format='jyear', scale='tdb')
    frame = GCRS(obstime=time, obsgeoloc=[0.0, 0.0, 0.0] * units.m,
                 obsgeovel=velocity_m_s * units.m / units.s)
    stars = SkyCoord(*directions.T, representation_type='cartesian', frame='icrs')
    stars = SkyCoord(ra=stars.spherical.lon, dec=stars.spherical.lat, frame='icrs')
    theirs = stars.transform_to(frame).cartesian.xyz.value.T
    state = state_near_earth(year, velocity_m_s)
    ours = apparent_directions(directions, state)
    towards_sun = -state.heliocentric_au / np.linalg.norm(state.heliocentric_au)
    far = directions @ towards_sun < np.cos(np.radians(10))
    assert np.linalg.norm((theirs - ours)[far], axis=1).max() < 0.001 * ARCSEC
    assert np.linalg.norm(ours - directions, axis=1).max() > 15 * ARCSEC


def test_the_opposite_velocity_is_the_inverse(directions):
    velocity = np.array([2e7, -1e7, 3e7])
    np.testing.assert_allclose(
        aberrate(aberrate(directions, velocity), -velocity), directions, atol=1e-14)


@pytest.mark.parametrize('day', [-6, 0, 3])
def test_two_line_elements_give_the_velocity_of_skyfield(day):
    timescale = load.timescale()
    satellite = EarthSatellite(*TLE, 'ISS', timescale)
    stamp_ns = EPOCH_NS + day * 86400 * 10 ** 9
    time = timescale.from_datetime(datetime.fromtimestamp(stamp_ns * 1e-9, UTC))
    theirs = satellite.at(time).velocity.km_per_s * 1e3
    assert np.linalg.norm(TwoLineOrbit(*TLE).velocity_m_s(stamp_ns) - theirs) < 0.1


@pytest.mark.parametrize('lines, reason', [
    ((TLE[0], ''), 'line 2'),
    ((TLE[0][:-1] + '0', TLE[1]), 'line 1'),
    (('', TLE[1]), 'line 1')])
def test_damaged_lines_are_named(lines, reason):
    with pytest.raises(OrbitError, match=reason):
        TwoLineOrbit(*lines)


@pytest.mark.parametrize('elements', [
    Elements(3.8e6, 0.0, 0.4, 1.0, 0.0, 2.0),  # low orbit of Mars
    Elements(7e6, 0.1, 0.4, 1.0, 0.0, 2.0),  # perigee inside of the Earth
    Elements(1.5e11, 0.0, 0.4, 1.0, 0.0, 2.0), Elements(7e6, 1.2, 0.4, 1.0, 0.0, 2.0)])
def test_elements_of_another_planet_are_named(elements):
    with pytest.raises(OrbitError, match='no (closed )?orbit'):
        KeplerOrbit(elements, 0)


def test_old_elements_are_not_used():
    epoch_ns = stamp_from_epoch_year(2026.5)
    orbit = KeplerOrbit(Elements(7e6, 0.001, 0.4, 1.0, 0.0, 2.0), epoch_ns)
    start = state_from_elements(Elements(7e6, 0.001, 0.4, 1.0, 0.0, 2.0))[1]
    np.testing.assert_allclose(orbit.velocity_m_s(epoch_ns), start)
    later = orbit.velocity_m_s(epoch_ns + 10 ** 12)
    orbit.velocity_m_s(epoch_ns + 5 * 10 ** 12)
    np.testing.assert_allclose(orbit.velocity_m_s(epoch_ns + 10 ** 12), later, atol=0.01)
    with pytest.raises(OrbitError, match='2.0 days off'):
        orbit.velocity_m_s(epoch_ns + 2 * 86400 * 10 ** 9)
    with pytest.raises(OrbitError, match='days off'):
        TwoLineOrbit(*TLE).velocity_m_s(epoch_ns)
    assert epoch_year_from_stamp(epoch_ns) == pytest.approx(2026.5, abs=1e-12)


def test_natural_directions_are_the_inverse_of_apparent_ones():
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((200, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    site = Site(-33.0, 151.0, 300.0)
    state = state_near_earth(2026.4, site.velocity_m_s(2026.4))._replace(air=site.air(2026.4))
    up = direction[direction @ state.air.zenith > 0.2]
    back = natural_directions(apparent_directions(up, state), state)
    assert np.abs(back - up).max() < 1e-4 * ARCSEC
