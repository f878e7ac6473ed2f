# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of fused heads in a few frames."""

import numpy as np
import pytest
from startracker_evaluation.campaign import heads
from startracker_evaluation.campaign.heads_scene import SIGMA_ARCSEC


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(heads, 'FRAMES', 300)
    monkeypatch.setattr(heads, '_SETTLED', 50)


def test_two_heads_reach_their_bounds():
    ratio, rms = heads.two_heads(2).reshape(2, 3)
    # 100 correlated frames: a factor of two is all they tell.
    assert np.all(ratio < 2) and np.all(ratio > 0.5)
    # No axis is as bad as the roll of a single head.
    assert np.all(rms < SIGMA_ARCSEC[2] / 3)


def test_a_frame_of_two_heads_is_at_the_cramer_rao_bound():
    np.testing.assert_allclose(np.mean(heads.snapshots(1, seed=3), axis=0), 1.0, atol=0.2)


def test_rows_name_what_holds():
    rows = heads._rows_faults('a fault', np.array([[100, 0, 0, 3], [90, 1, 1, 12]]))
    assert [row.holds for row in rows] == [True, False, False, False]
    rows = heads._rows_understated('two heads alike', np.array(
        [[3.0, 0, 0, 9, 2.9, 2, 0, 9000], [3.0, 1, 0, 9, 2.9, 1, 1, 900]]))
    assert [row.holds for row in rows] == [True, False, True, True, True, False, False]
    rows = heads._rows_understated('one head', np.array([[3.0, 1, 1, 9, 2.9, 1, 0, 10_000]]))
    assert [row.holds for row in rows] == [True, True, False, True, True, True, True]
    row, = heads.tracker_rows('mirrored image', np.array([[20, 0, 0, 0, 0, 0, 0, 0, 0.0]]))
    assert row.holds
