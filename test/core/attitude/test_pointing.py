# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The errors of the pointing against numerical derivatives."""

from hypothesis import given, strategies as st
import numpy as np
from startracker_ros.core.attitude.result import pointing_sigma
from startracker_ros.core.maths.rotation import (
    attitude_error, east_and_north, multiply, quaternion_from_pointing,
    quaternion_from_rotation_vector, rotate)

STEP_RAD = 1e-6
ROOT = np.array([[3.0, 0.0, 0.0], [1.0, 2.0, 0.0], [-2.0, 1.0, 5.0]])


@given(st.floats(0, 6.28), st.floats(-1.5, 1.5), st.floats(0, 6.28))
def test_sigma_is_that_of_small_rotations_about_icrf_axes(ra, dec, roll):
    q = quaternion_from_pointing(ra, dec, roll)
    boresight = rotate(q, [0.0, 0.0, 1.0])
    turned = [multiply(quaternion_from_rotation_vector(STEP_RAD * axis), q) for axis in np.eye(3)]
    moved = np.array([rotate(each, [0.0, 0.0, 1.0]) - boresight for each in turned])
    jacobian = np.vstack([east_and_north(boresight) @ moved.T,
                          [attitude_error(each, q)[2] for each in turned]]) / STEP_RAD
    np.testing.assert_allclose(pointing_sigma(q, ROOT @ ROOT.T),
                               np.linalg.norm(jacobian @ ROOT, axis=1), rtol=1e-4)
