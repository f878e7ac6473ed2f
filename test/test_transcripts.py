# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Twenty runs give what test/golden has of them: the same stars, states, reasons and attitudes."""

import numpy as np
import pytest
from startracker_ros.core.maths.rotation import attitude_error
from transcripts import NAMES, path_of, transcript

FIGURES = 1e-3  # of covariances and bounds
SIGMAS = 1e-2  # of an attitude, in its own sigma
CENTROID_PX = 1e-4


@pytest.mark.parametrize('name', NAMES)
def test_a_run_is_as_before(name):
    with np.load(path_of(name)) as before:
        after = transcript(name)
        for discrete in ('centroids', 'identifications', 'identified', 'tracks', 'state',
                         'reason'):
            np.testing.assert_array_equal(after[discrete], before[discrete], discrete)
        np.testing.assert_array_equal(after['track'][:, [0, 3]], before['track'][:, [0, 3]])
        np.testing.assert_allclose(after['centroid'][:, :2], before['centroid'][:, :2],
                                   rtol=0, atol=CENTROID_PX)
        np.testing.assert_allclose(after['centroid'][:, 2:], before['centroid'][:, 2:],
                                   rtol=FIGURES, atol=1e-9)
        found, expected = after['attitude'], before['attitude']
        np.testing.assert_array_equal(np.isnan(found[:, 0]), np.isnan(expected[:, 0]))
        published = ~np.isnan(expected[:, 0])
        assert published.any()
        for one, other in zip(found[published], expected[published]):
            sigma = np.sqrt(np.diag(other[4:13].reshape(3, 3)))
            assert (np.abs(attitude_error(one[:4], other[:4])) < SIGMAS * sigma).all()
            np.testing.assert_allclose(one[[4, 8, 12]], other[[4, 8, 12]], rtol=FIGURES)
            rate_sigma = np.sqrt(np.diag(other[16:25].reshape(3, 3)))
            assert (np.abs(one[13:16] - other[13:16]) < SIGMAS * rate_sigma).all()
            np.testing.assert_allclose(one[25:28], other[25:28], rtol=10 * FIGURES)
