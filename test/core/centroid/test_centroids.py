# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists of stars."""

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids


def test_columns_of_a_table_are_lists_of_stars():
    table = np.arange(30.0).reshape(6, 5)
    stars = Centroids(table[:, :2], table[:, 2], table[:, 3], table[:, 4])
    for value, column in ((stars.uv, table[:, :2]), (stars.flux, table[:, 2]),
                          (stars.snr, table[:, 3]), (stars.sigma_px, table[:, 4])):
        assert value.flags.c_contiguous
        np.testing.assert_array_equal(value, column)
