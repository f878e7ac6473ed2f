# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The split of errors into bias, field-of-view, pixel and temporal ones."""

from functools import partial

import numpy as np
import pytest
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.tools.datasheet.estimates import (
    AXES, bias, EXACT, fov_spatial, pixel_spatial, temporal_noise)
from startracker_ros.tools.datasheet.single_images import ImageErrors, SHIFTS

FIELDS = 2000
BIAS, FOV, PIXEL, NOISE = 4.0, 0.3, 0.5, 2.0


@pytest.fixture(scope='module')
def errors() -> ImageErrors:
    rng = np.random.default_rng(1)
    shape = (FIELDS, SHIFTS, 3)
    spatial = (np.array([BIAS, 0, 0]) + rng.normal(0, FOV, (FIELDS, 1, 3))
               + rng.normal(0, PIXEL, shape))
    noise = rng.normal(0, NOISE, shape)
    identified = np.ones(FIELDS, bool)
    for each in (spatial, noise):
        each[:5], each[7, 2] = np.nan, np.nan
    identified[:5] = False
    return ImageErrors(noise * ARCSEC, spatial * ARCSEC, np.full(shape, 1.5 * ARCSEC) ** 2,
                       identified)


@pytest.mark.parametrize('axis', AXES)
def test_each_part_is_found_again(errors, axis):
    columns = AXES[axis]
    for estimate, true in ((temporal_noise, NOISE), (pixel_spatial, PIXEL),
                           (partial(fov_spatial, EXACT), FOV)):
        found = estimate(errors, columns)
        assert found.value == pytest.approx(true, rel=0.1)
        assert found.low < found.value < found.high
        assert found.high - found.low < 0.3 * true
    assert temporal_noise(errors, columns).bound == pytest.approx(1.5)
    assert bias(EXACT, errors, columns).value == pytest.approx(
        BIAS if axis == 'cross boresight' else 0.0, abs=0.05)


def test_calibrations_add_their_bias_and_their_scatter(errors):
    rng, columns = np.random.default_rng(2), AXES['cross boresight']
    means, scatter = rng.normal(0, 3.0, (400, 1, 3)), rng.normal(0, 0.4, (400, 50, 3))
    calibrations = (means + scatter) * ARCSEC
    calibrations[3, 7] = np.nan
    found = bias(calibrations, errors, columns)
    assert found.value == pytest.approx(np.sqrt(BIAS ** 2 + 2 * 3.0 ** 2), rel=0.05)
    assert found.low < found.value < found.high
    assert fov_spatial(calibrations, errors, columns).value == pytest.approx(
        np.hypot(FOV, 0.4), rel=0.05)


@pytest.mark.filterwarnings('error')
def test_without_any_attitude_there_is_no_figure():
    nothing = np.full((3, SHIFTS, 3), np.nan)
    empty = ImageErrors(nothing, nothing, nothing, np.zeros(3, bool))
    for estimate in (pixel_spatial, partial(fov_spatial, EXACT), partial(bias, EXACT),
                     temporal_noise):
        assert np.isnan(estimate(empty, AXES['cross boresight']).value)
