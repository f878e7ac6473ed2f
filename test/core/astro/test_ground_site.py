# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras on the ground and other frames, against astropy and Skyfield."""

from astropy import units
from astropy.coordinates import AltAz, EarthLocation, GCRS, ITRS, SkyCoord
from astropy.time import Time
import numpy as np
import pytest
from skyfield.api import load, wgs84
from skyfield.framelib import ICRS_to_J2000
from startracker_ros.core.astro.aberration import refract
from startracker_ros.core.astro.earth import gcrs_from_itrf, gcrs_from_j2000
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.maths.rotation import ARCSEC

UNIX_S = 1_700_000_000
YEAR = epoch_year_from_stamp(UNIX_S * 10 ** 9)
TIME = Time(UNIX_S, format='unix', scale='utc')
SITE = Site(48.0, 11.5, 500.0)
LOCATION = EarthLocation.from_geodetic(11.5, 48.0, 500.0)


def test_velocity_and_zenith_of_a_site():
    theirs = wgs84.latlon(48.0, 11.5, 500.0).at(load.timescale().from_astropy(TIME))
    assert np.linalg.norm(SITE.velocity_m_s(YEAR) - theirs.velocity.m_per_s) < 0.1
    up = AltAz(alt=90 * units.deg, az=0 * units.deg, obstime=TIME, location=LOCATION)
    gcrs = SkyCoord(up).transform_to(ITRS(obstime=TIME, location=LOCATION))
    zenith = gcrs_from_itrf(YEAR, float(TIME.delta_ut1_utc)) @ gcrs.cartesian.xyz.value
    zenith /= np.linalg.norm(zenith)
    # Polar motion is left out.
    assert np.linalg.norm(SITE.zenith(YEAR, float(TIME.delta_ut1_utc)) - zenith) < ARCSEC


def test_frames_of_the_earth_and_of_j2000():
    axes = SkyCoord(*np.eye(3), representation_type='cartesian', frame=GCRS(obstime=TIME))
    theirs = axes.transform_to(ITRS(obstime=TIME)).cartesian.xyz.value
    ours = gcrs_from_itrf(YEAR, float(TIME.delta_ut1_utc)).T
    assert np.abs(ours - theirs).max() < 0.6 * ARCSEC
    # A tenth of a second of UT1 is 1.5 arcsec of longitude.
    late = gcrs_from_itrf(YEAR, float(TIME.delta_ut1_utc) + 0.1).T
    assert np.abs(late - theirs).max() == pytest.approx(1.5 * ARCSEC, rel=0.4)
    # The frame bias of J2000, 0.02 arcsec.
    assert np.abs(gcrs_from_j2000().T - ICRS_to_J2000).max() < 1e-4 * ARCSEC
    assert np.abs(gcrs_from_j2000() - np.eye(3)).max() > 0.01 * ARCSEC


@pytest.mark.parametrize('altitude_deg, tolerance_arcsec', [
    (85.0, 0.02), (70.0, 0.02), (45.0, 0.05), (30.0, 0.1), (15.0, 0.5)])
def test_refraction_is_that_of_erfa(altitude_deg, tolerance_arcsec):
    air = SITE.air(YEAR)
    altitude = np.radians(altitude_deg)
    across = np.cross(air.zenith, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    direction = np.sin(altitude) * air.zenith + np.cos(altitude) * across
    raised = refract(direction[None], air)[0]
    lift = np.arcsin(raised @ air.zenith) - altitude
    # The series is defined by the observed zenith distance.
    tangent = np.tan(np.pi / 2 - altitude - lift)
    expected = air.a_rad * tangent + air.b_rad * tangent ** 3
    assert abs(lift - expected) < tolerance_arcsec * ARCSEC
    assert abs(raised @ np.cross(air.zenith, across)) < 1e-12


def test_refraction_at_70_deg_is_20_arcsec():
    stars = AltAz(alt=70 * units.deg, az=40 * units.deg, obstime=TIME, location=LOCATION)
    air = Site(48.0, 11.5, 0.0).air(YEAR)
    up = np.sin(np.radians(stars.alt.deg)) * air.zenith
    side = np.cross(air.zenith, [1.0, 0.0, 0.0])
    side *= np.cos(np.radians(stars.alt.deg)) / np.linalg.norm(side)
    lift = np.linalg.norm(refract((up + side)[None], air)[0] - up - side)
    assert 20 * ARCSEC < lift < 22 * ARCSEC
    assert Site(48.0, 11.5, 0.0, pressure_hpa=0.0).air(YEAR) is None
    thin = Site(48.0, 11.5, 5000.0).air(YEAR)
    assert 0.5 < thin.a_rad / air.a_rad < 0.6
