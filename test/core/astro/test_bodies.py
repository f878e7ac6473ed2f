# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets, Moon and Sun against JPL ephemerides and astropy."""

from pathlib import Path

from astropy import units
from astropy.coordinates import EarthLocation, get_body
from astropy.time import Time
import numpy as np
import pytest
import skyfield
from skyfield.api import load, load_file, wgs84
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth, sun_direction
from startracker_ros.core.astro.earth import earth_velocity_m_s, EpochError
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.maths.rotation import ARCSEC

# Excerpts of a few days that Skyfield has for its own tests.
EPHEMERIDES = Path(skyfield.__file__).parent / 'tests' / 'data'
SITE = Site(-33.0, 151.0, 300.0)
LARGE = ('JUPITER BARYCENTER', 'SATURN BARYCENTER', 'URANUS BARYCENTER', 'NEPTUNE BARYCENTER')
TARGETS = ('MERCURY', 'VENUS', 'MARS BARYCENTER', *LARGE, 'MOON', 'SUN')


def separation(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def year_of(time):
    return epoch_year_from_stamp(round(time.utc_datetime().timestamp() * 1e9))


@pytest.mark.parametrize('file, hour', [
    ('de430-2015-03-02', (2015, 2, 27, 6)), ('de430-2015-03-02', (2015, 3, 4, 18)),
    ('de441-1969', (1969, 7, 30, 3))])
def test_directions_are_those_of_jpl(file, hour):
    kernel = load_file(str(EPHEMERIDES / f'{file}.bsp'))
    time = load.timescale().utc(*hour)
    from_centre = bodies_from_earth(year_of(time))
    from_site = bodies_from_earth(year_of(time), SITE.position_m(year_of(time)))
    place = kernel['EARTH'] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    for index, target in enumerate(TARGETS):
        limit_arcsec = 60 if target in LARGE else 20
        for seen, observer in ((from_centre, kernel['EARTH']), (from_site, place)):
            true = observer.at(time).observe(kernel[target]).position.au
            error = separation(seen.direction[index], true / np.linalg.norm(true))
            assert error < limit_arcsec * ARCSEC, (target, error / ARCSEC)


@pytest.mark.parametrize('text', ['2001-01-01T05:00:00', '2018-08-08T20:00:00',
                                  '2024-11-23T01:30:00'])
def test_apparent_directions_are_those_of_astropy(text):
    time = Time(text, scale='utc')
    year = epoch_year_from_stamp(round(time.unix * 1e9))
    for position, location in ((None, None), (SITE.position_m(year), EarthLocation.from_geodetic(
            SITE.longitude_deg, SITE.latitude_deg, SITE.height_m))):
        seen = bodies_from_earth(year, position).direction
        velocity = earth_velocity_m_s(year) + (0 if position is None else SITE.velocity_m_s(year))
        for name, direction in zip(BODIES, aberrate(seen, velocity)):
            theirs = get_body(name.lower(), time, location, ephemeris='builtin').cartesian.xyz
            theirs = theirs.to_value(units.au)
            # UTC serves as TT and UT1: seconds of the Moon, and of the rotation of the Earth.
            limit_arcsec = 5 if name == 'Moon' else 1
            assert separation(direction, theirs) < limit_arcsec * ARCSEC, name


@pytest.mark.parametrize('name, year, magnitude', [
    # Oppositions and the greatest brilliancy of Venus, from the Astronomical Almanac.
    ('Jupiter', 2022.737, -2.9), ('Mars', 2020.784, -2.6), ('Mars', 2022.936, -1.9),
    ('Venus', 2023.515, -4.6), ('Uranus', 2022.857, 5.6), ('Neptune', 2022.709, 7.8),
    # The eclipsed Moon of 2022-11-08 without its eclipse.
    ('Moon', 2022.852, -12.7), ('Sun', 2022.5, -26.7)])
def test_magnitudes_agree_with_the_almanac(name, year, magnitude):
    found = bodies_from_earth(year).magnitude[BODIES.index(name)]
    assert found == pytest.approx(magnitude, abs=0.2)


def test_discs_of_the_moon_and_the_sun():
    radius_deg = dict(zip(BODIES, np.degrees(bodies_from_earth(2026.4).radius_rad)))
    assert 0.24 < radius_deg['Moon'] < 0.28 and 0.262 < radius_deg['Sun'] < 0.272
    assert 5 < radius_deg['Jupiter'] * 7200 * 2 < 105


@pytest.mark.parametrize('year', [1500.0, 1969.5, 2026.4, 2300.0])
def test_the_direction_of_the_sun_in_any_year(year):
    sun = sun_direction(year)
    assert np.linalg.norm(sun) == pytest.approx(1)
    if 1900 < year < 2100:
        assert separation(sun, bodies_from_earth(year).direction[-1]) < 10 * ARCSEC
    else:
        with pytest.raises(EpochError):
            bodies_from_earth(year)
