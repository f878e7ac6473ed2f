# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The band of a camera, from stars whose fluxes it made."""

import numpy as np
import pytest
from startracker_ros.core.calibration.adjustment import MatchedStars
from startracker_ros.core.calibration.photometry import fit_band
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BANDS, magnitude_in_band
from startracker_ros.core.catalog.stars import load_catalog

CAMERA = Camera.from_fov(1024, 768, 11.4)


def stars_of(band, rng, *, corner_mag=0.0, noise_mag=0.05, count=400, frames=4):
    """Return stars of several frames whose fluxes a camera of a band made."""
    catalog = load_catalog()
    chosen = rng.choice(len(catalog.brighter_than(7.0)), count, replace=False)
    uv = rng.uniform(0, [1023, 767], (count, 2))
    frame = rng.integers(0, frames, count)
    r2 = np.sum((uv - [511.5, 383.5]) ** 2, axis=1) / (511.5 ** 2 + 383.5 ** 2)
    magnitude = catalog.magnitude[chosen].astype(float)
    seen = (magnitude_in_band(magnitude, catalog.bp_rp[chosen], band) + 0.3 * frame
            + corner_mag * r2 + rng.normal(0, noise_mag, count))
    return MatchedStars(uv, np.full(count, 0.1), np.zeros((count, 3)), frame,
                        10 ** (-0.4 * seen), catalog.hip[chosen], magnitude)


@pytest.mark.parametrize('band, colour_term', [('V', 0.0), ('G', 1.0)])
def test_the_band_is_found(band, colour_term):
    found = fit_band(stars_of(band, np.random.default_rng(1), corner_mag=0.4), CAMERA)
    assert abs(found.colour_term - colour_term) < 3.5 * found.colour_term_sigma < 0.1
    assert found.corner_mag == pytest.approx(0.4, abs=0.05)
    assert found.scatter_mag == pytest.approx(0.05, rel=0.1)
    assert min(found.band_scatter_mag, key=found.band_scatter_mag.get) == band


def test_variables_change_the_scatter_and_not_the_band():
    stars = stars_of('V', np.random.default_rng(2))
    stars.flux[:20] *= 5
    found = fit_band(stars, CAMERA)
    assert abs(found.colour_term) < 3.5 * found.colour_term_sigma
    assert 0.3 < found.scatter_mag < 0.5


def test_known_variables_are_not_fitted():
    """Half of the stars, all of them variables and all too bright in the red."""
    catalog = load_catalog()
    stars = stars_of('V', np.random.default_rng(5))
    variables = np.flatnonzero((catalog.variation_mag > 0) & (catalog.magnitude < 7))[:400]
    swapped = np.arange(0, 400, 2)
    stars.hip[swapped] = catalog.hip[variables[swapped]]
    stars.flux[swapped] *= 1.3 ** catalog.bp_rp[variables[swapped]]
    found = fit_band(stars, CAMERA)
    assert abs(found.colour_term) < 3.5 * found.colour_term_sigma < 0.15
    assert found.scatter_mag > 0.2


@pytest.mark.parametrize('count', [0, 5, 17])
def test_too_few_stars_have_no_band(count):
    stars = stars_of('V', np.random.default_rng(3), count=400).select(np.arange(count))
    found = fit_band(stars, CAMERA)
    assert np.isnan(found.colour_term) and set(found.band_scatter_mag) == set(BANDS)


def test_fluxes_without_light_are_left_out():
    stars = stars_of('V', np.random.default_rng(4))
    stars.flux[:50] = 0.0
    assert fit_band(stars, CAMERA).scatter_mag == pytest.approx(0.05, rel=0.15)


def test_bands_of_vega_like_and_red_stars():
    # Riello et al. (2021): an A0 star has the same magnitude in all bands.
    for band in BANDS:
        assert magnitude_in_band(np.array([5.0]), np.array([0.0]), band) == pytest.approx(
            5.0, abs=0.03)
    # Betelgeuse and its like are a magnitude brighter in G; no colour is beyond the table.
    red = magnitude_in_band(np.array([0.5]), np.array([2.4]), 'G')
    assert red == pytest.approx(0.5 - 1.04, abs=0.05)
    assert np.isfinite(magnitude_in_band(np.zeros(2), np.array([-3.0, 9.0]), 'Hp')).all()
