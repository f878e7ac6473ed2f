# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A field smeared by a fast turn, from the image on."""

import numpy as np
import pytest
from skies import CAMERA
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

EPOCH_YEAR = 2026.5


@pytest.fixture(scope='module')
def identifier():
    return make_identifier(CAMERA, EPOCH_YEAR)


@pytest.mark.parametrize('rate_deg_s', [(0.0, 0.5, 0.0), (0.35, -0.35, 0.0), (0.3, 0.0, 2.0)])
def test_half_a_degree_a_second_still_solves(identifier, rate_deg_s):
    """In 100 ms the stars move by four pixels or more."""
    for index in range(4):
        motion = motion_from_options(MotionOptions(
            motion='constant_rate', ra_deg=90.0 * index, dec_deg=-60.0 + 40 * index,
            rate_deg_s=rate_deg_s))
        frame = SkySimulator(CAMERA, motion, load_catalog(), EPOCH_YEAR, seed=index,
                             detector_options=DetectorOptions(motion_smear=True),
                             sky_options=SkyOptions(aberration=False)).frame(0.1)
        result = identifier.identify(CentroidExtractor().measure(frame.image).centroids)
        assert result.status == 'identified', result.reason
        error = np.abs(attitude_error(result.attitude.quaternion,
                                      frame.state.q_icrf_from_sensor)) / ARCSEC
        assert np.hypot(error[0], error[1]) < 5 and error[2] < 60
