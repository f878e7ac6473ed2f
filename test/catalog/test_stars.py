"""Stars and their motion, against ERFA and the literature."""

import warnings

import erfa
import numpy as np
import pytest
from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.maths.rotation import ARCSEC, unit_from_radec

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
    # One arc second leaves room for the orbit of alpha Centauri.
    assert separation_rad(direction, place) < 1 * ARCSEC


@pytest.mark.parametrize('years', [-50.0, 0.0, 8.75, 35.0, 50.0])
def test_directions_agree_with_erfa(years):
    catalog = load_catalog()
    year = 1991.25 + years
    mas = ARCSEC / 1000
    with warnings.catch_warnings():
        # ERFA warns that it replaces parallaxes of zero and below by a small one.
        warnings.simplefilter('ignore', erfa.ErfaWarning)
        ra_rad, dec_rad, *_ = erfa.pmsafe(
            catalog.ra_rad, catalog.dec_rad,
            catalog.pm_ra_mas_yr * mas / np.cos(catalog.dec_rad), catalog.pm_dec_mas_yr * mas,
            catalog.parallax_mas / 1000.0, 0.0, julian_date(1991.25), 0.0, julian_date(year), 0.0)
    error = separation_rad(catalog.directions(year), unit_from_radec(ra_rad, dec_rad))
    assert error.max() < 0.1 * mas


def test_directions_are_unit_vectors():
    length = np.linalg.norm(load_catalog().directions(2500.0), axis=1)
    np.testing.assert_allclose(length, 1, atol=1e-14)


def test_epoch_of_a_stamp():
    assert epoch_year_from_stamp(946_728_000 * 10 ** 9) == 2000.0
    assert epoch_year_from_stamp(0) == pytest.approx(1970.0, abs=2e-3)
    # 2024-01-01T00:00:00Z is JD 2460310.5.
    assert epoch_year_from_stamp(1_704_067_200 * 10 ** 9) == pytest.approx(
        2000 + (2460310.5 - J2000_JD) / 365.25, abs=1e-12)
