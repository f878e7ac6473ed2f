# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A warm-up identifies a real field, by every method, and leaves nothing behind."""

import numpy as np
import pytest
from skies import SMALL_CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import synthetic_field
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.papers.extended_grid import RecursiveIdentifier
from startracker_ros.core.registry import METHODS

EPOCH_YEAR = 2026.5


@pytest.mark.parametrize('method, fov_deg', [
    *((method, 20.0) for method in METHODS), ('pyramid', 6.0), ('pyramid', 12.0),
    ('pyramid', 40.0), ('extended_grid', 4.0)])
def test_the_field_of_a_warm_up_is_identified(method, fov_deg, monkeypatch):
    camera = Camera.from_fov(512, 512, fov_deg)
    identifier = make_identifier(camera, EPOCH_YEAR, IdentificationOptions(method=method))
    results = []
    identify = type(identifier).identify
    monkeypatch.setattr(type(identifier), 'identify', lambda self, *given: results.append(
        (given, identify(self, *given))) or results[-1][1])
    identifier.warm_up()
    # Without a predicted attitude, and with one where the method uses it.
    assert len(results) == (2 if method == 'extended_grid' else 1)
    hip = synthetic_field(identifier.onboard, camera)[1]
    for _, result in results:
        assert result.status == 'identified'
        known = result.hip > 0
        np.testing.assert_array_equal(result.hip[known], hip[known])


def test_a_warm_up_is_no_frame_of_a_recursive_identifier():
    recursive = RecursiveIdentifier(make_identifier(
        SMALL_CAMERA, EPOCH_YEAR, IdentificationOptions(method='extended_grid')))
    recursive.warm_up()
    assert recursive.condition == 'no frame yet' and not recursive.has_rates
