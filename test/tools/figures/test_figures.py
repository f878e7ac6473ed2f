# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows and their columns, bounds, correctness of attitudes, steal time."""

from dataclasses import fields, replace
import gc
import json
from types import SimpleNamespace

import numpy as np
import pytest
from startracker_evaluation.extras import peer_versions
from startracker_ros.core.maths.rotation import ARCSEC, quaternion_from_rotation_vector
from startracker_ros.io.table import Result, show
from startracker_ros.tools.figures import machine
from startracker_ros.tools.figures.correctness import (
    count_wrong, error_over_bound, is_correct, is_wrong, over_bound, verdict)
from startracker_ros.tools.figures.rows import (
    BenchRow, CampaignRow, combined, judged, mean_chi_square_bounds, PaperRow, PercentileRow, Row,
    trials_for_percent)
from startracker_ros.tools.figures.timing import cpu_timed, garbage_collector_off

TRUTH = np.array([0.0, 0.0, 0.0, 1.0])


def off(*angles_rad):
    """Return an attitude off from the truth by angles about the sensor axes."""
    return quaternion_from_rotation_vector(np.array(angles_rad))


@pytest.mark.parametrize('kind, columns', [
    (Row, 'case ours unit bound holds'),
    (BenchRow, 'case ours unit peer ratio bound holds'),
    (PercentileRow, 'case ours p95 p99 unit peer ratio bound holds'),
    (CampaignRow, 'case ours paper unit bound holds'),
    (PaperRow, 'case paper as_published beyond unit bound holds ours')])
def test_columns_are_the_keys_of_the_json_document(kind, columns):
    assert [column.name for column in fields(kind)] == columns.split()


def test_rows_are_printed_as_json_values(capsys):
    row = BenchRow('a', np.float64(1.5), 'ms', ratio=float('nan'), holds=np.bool_(True))
    result = Result('x', [row, {'case': 'b', 'holds': False}])
    show(result, as_json=True)
    assert json.loads(capsys.readouterr().out)['rows'] == [
        {'case': 'a', 'ours': 1.5, 'unit': 'ms', 'peer': '', 'ratio': None, 'bound': '',
         'holds': True}, {'case': 'b', 'holds': False}]
    assert not result.holds and replace(result, rows=[row]).holds
    assert replace(result, rows=[row, {'case': 'c', 'holds': None}]).holds


def test_percentiles_have_bounds_where_these_are_finite():
    times_ms = np.arange(101.0)
    row = PercentileRow.of_times('a', times_ms, 50.0, 94.0)
    assert (row.ours, row.p95, row.p99) == (50, 95, 99)
    assert row.bound == 'p50 <= 50, p95 <= 94' and not row.holds
    assert PercentileRow.of_times('a', times_ms).bound == ''
    assert combined([]) == ('', True) and combined([('a', True), ('b', False)]) == ('a; b', False)


@pytest.mark.parametrize(('limits', 'bound', 'holds'), [
    ({'most': 3}, '<= 3', True), ({'most': 2.5}, '<= 2.5', False), ({'least': 3}, '>= 3', True),
    ({'least': 3.5}, '>= 3.5', False), ({'exactly': 3}, '= 3', True),
    ({'exactly': 0}, '= 0', False), ({'least': 2.7, 'most': 3.3}, '2.7 .. 3.3', True),
    ({'least': 2, 'most': 2.9}, '2 .. 2.9', False), ({}, '', True)])
def test_a_bound_follows_from_the_limits(limits, bound, holds):
    row = Row('case', np.float64(3), 'm', **limits)
    assert (row.bound, row.holds) == (bound, holds)
    assert replace(row, case='other') == Row('other', 3.0, 'm', bound, holds)


def test_the_figure_of_ours_is_the_one_beyond_the_paper():
    assert PaperRow('a', '> 97.4', 98.0, 99.0).ours == 99
    assert PaperRow('a', '> 97.4', 98.0).ours == 98


def test_a_bound_with_too_few_trials_is_not_judged():
    checks = [('a >= 1', True), ('b >= 1', False)]
    assert judged(checks, 20, 20) == ('a >= 1; b >= 1', False)
    assert judged(checks, 19, 20) == ('a >= 1; b >= 1: too few trials, 19 of 20', None)
    assert judged([], 0, 20) == ('', True)
    # Ten failures are expected in so many trials.
    assert trials_for_percent(97.5) == 400 == trials_for_percent(2.5)
    with pytest.raises(ValueError):
        trials_for_percent(100)


def test_means_of_chi_square_values_are_within_the_bounds():
    low, high = mean_chi_square_bounds(3, 50)
    means = np.random.default_rng(1).chisquare(3, (4000, 50)).mean(axis=1)
    assert np.mean((low < means) & (means < high)) == pytest.approx(0.95, abs=0.015)


def test_correct_attitudes_are_within_the_angles():
    x, y, roll = np.radians([0.03, 0.03, 0.45])
    assert is_correct(off(x, y, roll), TRUTH) and is_correct(-off(x, y, -roll), TRUTH)
    assert not is_correct(off(2 * x, 0, 0), TRUTH) and not is_correct(off(0, 0, 2 * roll), TRUTH)


def test_wrong_attitudes_exceed_the_bound_of_their_covariance():
    sigma_rad = 10 * ARCSEC * np.array([1.0, 2.0, 10.0])
    covariance = np.diag(sigma_rad ** 2)
    for axis, bound in enumerate((50, 100, 500)):
        error = np.eye(3)[axis] * bound * ARCSEC
        assert error_over_bound(off(*error), covariance, TRUTH) == pytest.approx(1)
        assert is_wrong(off(*1.01 * error), covariance, TRUTH)
        assert not is_wrong(-off(*0.99 * error), covariance, TRUTH)
    np.testing.assert_allclose(over_bound(
        ARCSEC * np.array([[50, 80, 0], [0, 0, -1000]]), np.tile(sigma_rad, (2, 1))), [1, 2])


def test_wrong_attitudes_are_gross_beyond_60_arcsec_of_the_axis_that_is_wrong():
    sigma_rad = 10 * ARCSEC * np.array([1.0, 2.0, 10.0])
    assert verdict(off(55 * ARCSEC, 0, 0), np.diag(sigma_rad ** 2), TRUTH) == (1, 0)
    # The third is within its sigma about z, the last is not an attitude.
    errors = ARCSEC * np.array([[55, 0, 0], [-61, 0, 0], [55, 0, 400], [0, 0, 501], [9, 9, 9]])
    assert count_wrong(np.vstack([errors, np.full(3, np.nan)]), sigma_rad) == (4, 2)
    assert count_wrong(errors[None], sigma_rad) == (4, 2)


def test_calls_are_timed_without_the_garbage_collector():
    with garbage_collector_off():
        assert not gc.isenabled()
        cpu_s, result = cpu_timed(sorted, range(100_000), reverse=True)
    assert gc.isenabled() and result[0] == 99_999 and 0 < cpu_s < 1


def test_steal_time_is_that_since_the_start(monkeypatch):
    times_s = iter([SimpleNamespace(user=8.0, system=2.0, steal=0.5),
                    SimpleNamespace(user=8.8, system=2.1, steal=0.6)])
    monkeypatch.setattr(machine.psutil, 'cpu_times', lambda: next(times_s))
    assert str(machine.StealTime()) == '10.0% steal time'


def test_versions_of_what_is_not_installed_say_how_to_install_it():
    versions = peer_versions('numpy', 'no-such-package')
    assert versions['numpy'] == np.__version__ and 'pip install' in versions['no-such-package']
    assert machine.machine('load 1').endswith(f'NumPy {np.__version__}, load 1')
