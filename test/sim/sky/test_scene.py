# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pixels of stars, against the formulas of spherical astronomy."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from skies import CAMERA
from skyfield.api import load, Star
from skyfield.positionlib import Barycentric
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog, RADIAL_VELOCITY_KM_S
from startracker_ros.core.maths.rotation import (
    conjugate, quaternion_from_pointing, rotate, unit_from_radec)
from startracker_ros.sim.sky.exposure import project_visible
from startracker_ros.sim.sky.sources import SceneStars

EPOCH_YEAR = 2026.0
BETELGEUSE, RIGEL, ALNILAM, BELLATRIX = 27989, 24436, 26311, 25336


def stars_at(ra_deg, dec_deg, roll_deg=0.0, camera=CAMERA, margin_px=0.0):
    catalog = load_catalog()
    q = quaternion_from_pointing(*np.radians([ra_deg, dec_deg, roll_deg]))
    uv = project_visible(camera, rotate(conjugate(q), catalog.directions(EPOCH_YEAR)), margin_px)
    visible = camera.contains(uv, -margin_px)
    return SceneStars(catalog.hip[visible], uv[visible], catalog.magnitude[visible])


def pixel(stars, hip):
    return stars.uv[np.flatnonzero(stars.hip == hip)[0]]


@given(st.floats(0, 359), st.floats(-89, 89))
@settings(max_examples=20)
def test_gnomonic_formula(ra_deg, dec_deg):
    """The textbook projection about the field centre; image x points west at roll 0."""
    stars = stars_at(ra_deg, dec_deg)
    catalog = load_catalog()
    direction = catalog.directions(EPOCH_YEAR)
    ra, dec = np.arctan2(direction[:, 1], direction[:, 0]), np.arcsin(direction[:, 2])
    ra0, dec0 = np.radians([ra_deg, dec_deg])
    depth = np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(ra - ra0)
    with np.errstate(divide='ignore'):
        east = np.cos(dec) * np.sin(ra - ra0) / depth
        north = (np.sin(dec) * np.cos(dec0)
                 - np.cos(dec) * np.sin(dec0) * np.cos(ra - ra0)) / depth
    focal = 512 / np.tan(np.radians(6))
    uv = np.stack([511.5 - focal * east, 511.5 - focal * north], -1)
    seen = (depth > 0) & (np.abs(uv - 511.5) <= 512).all(-1)
    np.testing.assert_array_equal(stars.hip, catalog.hip[seen])
    np.testing.assert_allclose(stars.uv, uv[seen], atol=1e-6)
    assert (np.diff(stars.magnitude) >= 0).all()


def test_orion_stands_upright_and_is_not_mirrored():
    camera = Camera.from_fov(1024, 1024, 24.0)
    stars = stars_at(83.8, 0.0, camera=camera)
    betelgeuse, rigel, alnilam, bellatrix = (
        pixel(stars, hip) for hip in (BETELGEUSE, RIGEL, ALNILAM, BELLATRIX))
    # North up, east left: Betelgeuse is the upper left shoulder, Rigel the lower right foot.
    assert betelgeuse[0] < alnilam[0] < rigel[0] and betelgeuse[1] < alnilam[1] < rigel[1]
    assert bellatrix[0] > betelgeuse[0] and bellatrix[1] < alnilam[1]
    # SIMBAD, ICRS J2000: 05 55 10.305 +07 24 25.43 and 05 14 32.272 -08 12 05.90.
    simbad = unit_from_radec(*np.radians([[88.792938, 78.634467], [7.407064, -8.201639]]))
    q = quaternion_from_pointing(*np.radians([83.8, 0.0, 0.0]))
    expected = camera.project(rotate(conjugate(q), simbad))
    assert np.abs([betelgeuse, rigel] - expected).max() < 0.02


def test_directions_agree_with_skyfield():
    """Proper motion and projection of the fastest stars, seen from the barycentre."""
    catalog = load_catalog()
    barycentre = Barycentric([0, 0, 0], [0, 0, 0], t=load.timescale(builtin=True).J(EPOCH_YEAR))
    for hip in (71683, 104214, 19849, 84405, 99461):
        row = np.flatnonzero(catalog.hip == hip)[0]
        star = Star(ra_hours=np.degrees(catalog.ra_rad[row]) / 15,
                    dec_degrees=np.degrees(catalog.dec_rad[row]),
                    ra_mas_per_year=catalog.pm_ra_mas_yr[row],
                    dec_mas_per_year=catalog.pm_dec_mas_yr[row],
                    parallax_mas=catalog.parallax_mas[row],
                    radial_km_per_s=RADIAL_VELOCITY_KM_S.get(hip, 0.0), epoch=2448349.0625)
        expected = barycentre.observe(star).xyz.au
        ra_deg, dec_deg = np.degrees([catalog.ra_rad[row], catalog.dec_rad[row]])
        stars = stars_at(ra_deg - 1.0, dec_deg + 2.0)
        q = quaternion_from_pointing(*np.radians([ra_deg - 1.0, dec_deg + 2.0, 0.0]))
        uv = CAMERA.project(rotate(conjugate(q), expected))
        # 1e-3 px is 42 mas; these stars have moved by 60 arcsec or more.
        assert np.abs(pixel(stars, hip) - uv).max() < 1e-3


def test_roll_is_the_position_angle_of_image_up():
    north_up, rolled = stars_at(83.8, 0.0), stars_at(83.8, 0.0, roll_deg=90.0)
    right, down = pixel(north_up, ALNILAM) - 511.5
    # With east up, north (up before) lies to the right.
    np.testing.assert_allclose(pixel(rolled, ALNILAM) - 511.5, [-down, right], atol=1e-9)


@pytest.mark.parametrize('distortion', [(0.0,) * 5, (-0.2, 0.0, 1e-3, -1e-3, 0.0)])
def test_margin_takes_in_exactly_the_stars_around(distortion):
    camera = Camera(800, 600, 3000.0, 3000.0, 420.0, 280.0, distortion)
    wide, tight = (stars_at(250.0, -30.0, 33.0, camera, margin) for margin in (50.0, 0.0))
    assert len(wide) > len(tight) > 50
    np.testing.assert_array_equal(wide.hip[camera.contains(wide.uv)], tight.hip)
    assert camera.contains(wide.uv, -50.0).all()


def test_poles():
    assert pixel(stars_at(37.95, 89.26), 11767) == pytest.approx([511.5, 511.5], abs=3)
    assert len(stars_at(10.0, -89.9)) > 20
