# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The comparison of attitude solvers: fair draws, figures that can fail, all rows."""

import json

from commands import invoke
import numpy as np
import pytest
from startracker_evaluation.bench.attitude import (
    consistency_rows, draw, error_rows, Errors, measure, PEER, time_rows)
from startracker_ros.core.attitude.estimate import SOLVERS
from startracker_ros.core.maths.rotation import ARCSEC, rotate


def test_draws_are_as_described_and_repeatable():
    seen, same = (draw(2000, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(seen.sensor, same.sensor)
    assert np.degrees(np.arctan(np.abs(seen.sensor[:, :2] / seen.sensor[:, 2:]))).max() < 6.05
    assert seen.sigma_rad.min() > 5 * ARCSEC and seen.sigma_rad.max() < 20 * ARCSEC
    # The chord to the true direction is noise about two axes.
    off = seen.icrf - rotate(seen.quaternion, seen.sensor)
    assert np.sum(off ** 2 / seen.sigma_rad[:, None] ** 2) / 4000 == pytest.approx(1, abs=0.08)


def test_the_peer_finds_the_same_optimum():
    figures = measure([draw(10, np.random.default_rng(seed)) for seed in range(20)])
    np.testing.assert_allclose(figures['quest'].over_bound, figures[PEER].over_bound, atol=1e-4)
    assert figures['triad'].cross_boresight > figures['quest'].cross_boresight


def test_each_bound_can_fall_short():
    figures = measure([draw(10, np.random.default_rng(seed)) for seed in range(20)])
    assert all(row.holds for row in error_rows(10, figures))
    good = figures['svd']
    turned = {**figures, 'svd': Errors(
        1.5 * good.over_bound, good.nees, good.quaternion + [0, 0, 1e-9, 0])}
    assert sum(not row.holds for row in error_rows(10, turned)) == 3
    for factor in (0.5, 2):
        wrong = {**figures, 'svd': Errors(good.over_bound, factor * good.nees, good.quaternion)}
        assert not {row.case: row.holds for row in consistency_rows([wrong])}[
            'all: svd, normalised error squared']
    slow = {**dict.fromkeys(SOLVERS, 10.0), PEER: 60.0, 'triad': 26.0}
    assert [row.holds for row in time_rows(20, slow)] == [True, True, True, False]
    assert all(row.holds for row in time_rows(4, slow))


def test_the_command_runs_all():
    done = invoke('bench', 'attitude', '--trials', '200', '--vectors', '4', '--json')
    rows = {row['case']: row for row in json.loads(done.stdout)['rows']}
    assert len(rows) == 4 * 4 + 1
    for case, row in rows.items():
        assert row['holds'] or 'time' in case, case
        assert row['ours'] > 0 and ('time' not in case or row['unit'] == 'us')
