"""The split of errors into bias, field-of-view, pixel and temporal ones."""

import numpy as np
import pytest
from startracker_ros.datasheet.estimates import (
    AXES, bias, fov_spatial, pixel_spatial, temporal_noise)
from startracker_ros.datasheet.single_images import ImageErrors, SHIFTS
from startracker_ros.maths.rotation import ARCSEC

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
    for estimate, true in ((temporal_noise, NOISE), (pixel_spatial, PIXEL), (fov_spatial, FOV)):
        found = estimate(errors, columns)
        assert found.value == pytest.approx(true, rel=0.1)
        assert found.low < found.value < found.high
        assert found.high - found.low < 0.3 * true
    assert temporal_noise(errors, columns).bound == pytest.approx(1.5)
    assert bias(errors, columns).value == pytest.approx(
        BIAS if axis == 'cross boresight' else 0.0, abs=0.05)


def test_without_any_attitude_there_is_no_figure():
    nothing = np.full((3, SHIFTS, 3), np.nan)
    empty = ImageErrors(nothing, nothing, nothing, np.zeros(3, bool))
    for estimate in (pixel_spatial, fov_spatial, bias, temporal_noise):
        assert np.isnan(estimate(empty, AXES['cross boresight']).value)
