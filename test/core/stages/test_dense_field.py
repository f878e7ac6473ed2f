# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A small image of a wide field with more stars than one in 400 px."""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.photographs.solve import solve_image
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

CAMERA, YEAR = Camera.from_fov(512, 480, 50.0), 2026.0
PX_PER_PEAK = 400  # one peak is listed


def test_a_dense_image_is_solved_by_its_brightest_stars():
    motion = motion_from_options(MotionOptions(
        motion='inertial', ra_deg=85.0, dec_deg=5.0, roll_deg=20.0))
    frame = SkySimulator(
        CAMERA, motion, load_catalog(), YEAR, sky_options=SkyOptions(aberration=False),
        detector_options=DetectorOptions(zero_flux_e_s=6e7, full_well_e=6e4,
                                         gain_e_per_dn=16.0)).frame(0.0)
    seen = frame.stars.magnitude < 7.5
    assert np.count_nonzero(seen) > 1.2 * frame.image.size / PX_PER_PEAK
    identifier = make_identifier(CAMERA, YEAR)
    solution = solve_image(frame.image, CentroidExtractor(), identifier,
                           ApparentCatalog(identifier.onboard))
    assert solution.identification.matched >= 10, solution.identification.reason
    error = attitude_error(solution.quaternion, frame.q_mean)
    assert np.abs(error[:2]).max() < 0.2 * CAMERA.pixel_rad
