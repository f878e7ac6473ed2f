# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The catalogue in the band of an instrument."""

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import (
    BandOptions, catalog_in_band, COLOUR_BAND, G_BAND, HP_BAND, magnitude_in_band)
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.tracking import make_track_filter

BETELGEUSE, RIGEL = 27989, 24436


def test_the_band_of_v_is_the_catalogue_itself():
    assert catalog_in_band(load_catalog(), BandOptions()) is load_catalog()


@pytest.mark.parametrize('band', [HP_BAND, G_BAND])
def test_magnitudes_and_order_follow_the_band(band):
    catalog = load_catalog()
    found = catalog_in_band(catalog, BandOptions(band=band))
    assert (np.diff(found.magnitude) >= 0).all()
    order, there = np.argsort(catalog.hip), np.argsort(found.hip)
    np.testing.assert_array_equal(catalog.hip[order], found.hip[there])
    np.testing.assert_array_equal(catalog.ra_rad[order], found.ra_rad[there])
    np.testing.assert_allclose(
        found.magnitude[there],
        magnitude_in_band(catalog.magnitude, catalog.bp_rp, band)[order], atol=1e-6)


def test_a_colour_term_lies_between_v_and_g():
    def red_over_blue(**options):
        stars = catalog_in_band(load_catalog(), BandOptions(**options))
        magnitude = dict(zip(stars.hip.tolist(), stars.magnitude.tolist()))
        return magnitude[BETELGEUSE] - magnitude[RIGEL]

    v, g = red_over_blue(), red_over_blue(band=G_BAND)
    assert g < v - 0.5
    half = red_over_blue(band=COLOUR_BAND, colour_term=0.5)
    assert half == pytest.approx((v + g) / 2, abs=1e-5)
    assert red_over_blue(band=COLOUR_BAND, colour_term=1.0) == pytest.approx(g, abs=1e-5)


def test_identifier_and_tracker_predict_in_the_band():
    camera, band = Camera.from_fov(256, 256, 20.0), BandOptions(band=G_BAND)
    expected = {int(hip): magnitude for hip, magnitude in zip(
        *(getattr(camera_catalog(camera, band=band), name) for name in ('hip', 'magnitude')))}
    for onboard in (IdentificationStage(camera, 2026.0, band=band).identifier.onboard,
                    make_track_filter(camera, 2026.0, band=band).sky.onboard):
        # Most entries are single stars.
        assert len(onboard) > 100
        off = onboard.magnitude - [expected[int(hip)] for hip in onboard.hip]
        assert np.percentile(np.abs(off), 75) < 1e-3
