# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scalar formulas against NumPy."""

import numpy as np
from startracker_ros.core.maths.small_algebra import adjugate, cross


def test_cross_product():
    a, b = np.random.default_rng(1).normal(0, 1, (2, 3))
    np.testing.assert_allclose(cross(*a, *b), np.cross(a, b), rtol=1e-14)


def test_adjugate_of_symmetric_matrices():
    root = np.random.default_rng(2).normal(0, 1, (3, 3))
    matrix = root + root.T
    upper = np.triu_indices(3)
    expected = np.linalg.det(matrix) * np.linalg.inv(matrix)
    np.testing.assert_allclose(adjugate(*matrix[upper]), expected[upper], rtol=1e-12)
