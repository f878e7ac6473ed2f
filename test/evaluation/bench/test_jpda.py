# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The comparison of JPDA filters: scenes as described, right figures, checks that can fail."""

import json

from commands import invoke
import numpy as np
import pytest
from startracker_evaluation.bench import jpda as scene
from startracker_evaluation.bench.jpda import (
    bounds, FILTERS, moving_targets, Ours, run, swapped, Tally)


@pytest.mark.parametrize('kind', scene.SCENES)
def test_scenes_are_as_described_and_repeatable(kind):
    targets, same = (moving_targets(kind, 100, 10, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(np.concatenate(targets.frames), np.concatenate(same.frames))
    apart_px = np.linalg.norm(np.diff(targets.truth[..., ::2].reshape(-1, 50, 2, 2), axis=2),
                              axis=-1)[:, :, 0]
    if kind == 'close':
        np.testing.assert_allclose(apart_px[0], scene.CLOSE_PX)
        assert np.median(apart_px[-1]) < 3 * scene.CLOSE_PX
    elif kind == 'crossing':
        assert apart_px[scene.FRAMES // 2].max() <= 1
        assert apart_px[0].min() > 1 and apart_px[-1].min() > 1
    else:
        assert np.median(apart_px[0]) > 300
    seen = np.mean([len(uv) for uv in targets.frames])
    assert seen == pytest.approx(100 * scene.DETECTION_PROBABILITY + 10, abs=1.5)
    # Both ways from half time the targets accelerate as in the model of the filter.
    change = np.diff(targets.truth[..., [1, 3]], axis=0) / scene.DT_S
    assert change.std() == pytest.approx(scene.ACCELERATION_PX_S2, rel=0.05)
    moved = targets.truth[:-1, :, [0, 2]] + scene.DT_S * (
        targets.truth[:-1, :, [1, 3]] + change * scene.DT_S / 2)
    np.testing.assert_allclose(moved, targets.truth[1:, :, [0, 2]])


def test_swapped_tracks():
    truth = np.array([[0.0, 0], [5, 0], [20, 0]])
    assert swapped(truth + 0.4, truth).tolist() == [False] * 3
    assert swapped(truth[[1, 0, 2]], truth).tolist() == [True, True, False]
    assert swapped(truth[[0, 0, 2]], truth).tolist() == [False, True, False]


def test_ours_keeps_tracks_apart_and_is_as_exact_as_it_can_be():
    tally, rng = Tally(), np.random.default_rng(2)
    for _ in range(3):
        run(Ours, moving_targets('apart', 40, 10, rng), 10, tally)
    figures = tally.figures
    assert figures['tracks_run'] == 120 and figures['swapped'] == 0
    assert len(tally.cpu_s) == 3 * scene.FRAMES
    assert 0.4 < figures['rms_px'] / scene.SIGMA_PX < 0.6


def tally_of(median_ms, rms_px, swapped_tracks):
    return Tally([1e-3 * median_ms], [np.full((1, 4), rms_px ** 2)],
                 [np.isin(np.arange(4), swapped_tracks)])


def test_each_bound_can_fall_short():
    peers = {'one': tally_of(9, 0.1, [0, 1]), 'other': tally_of(9, 0.1, [1])}
    for ours, holds in ((tally_of(0.1, 0.1, [1]), [True] * 3),
                        (tally_of(0.5, 0.1, [1]), [False, True, True]),
                        (tally_of(0.1, 0.101, [1]), [True, False, True]),
                        (tally_of(0.1, 0.1, [0]), [True, True, False])):
        checks = bounds('crossing', 4, {'ours': ours, **peers})
        assert [held for _, held in checks] == holds
    assert len(bounds('close', 4, {'ours': ours, **peers})) == 2
    assert len(bounds('crossing', 4, {'ours': ours})) == 1
    assert not bounds('crossing', 100, {'ours': ours})


def test_the_command_runs_all_that_is_installed():
    done = invoke('bench', 'jpda', '--trials', '1', '--tracks', '5', '--scene', 'crossing',
                  '--json')
    rows = json.loads(done.stdout)['rows']
    assert {'ours'} <= {row['filter'] for row in rows} <= set(FILTERS)
    for row in rows:
        ours = next(own for own in rows if own['filter'] == 'ours'
                    and own['clutter'] == row['clutter'])
        assert row['rms_px'] == pytest.approx(ours['rms_px'], rel=1e-6)
        assert row['swapped'] == ours['swapped'] and row['tracks_run'] == 5
