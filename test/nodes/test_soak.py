# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A short soak: nothing is lost, nothing is wrong, no handle more at the end."""

import numpy as np
import pytest
from startracker_evaluation.campaign.resources import growth
from startracker_evaluation.campaign.soak import rows_of
from startracker_evaluation.harness.soak import NODES, Soak
# Half of a turn.
FRAMES = 60


@pytest.fixture(scope='module')
def result(tmp_path_factory):
    """Return what frames through the nodes showed, with several samples on the way."""
    folder = tmp_path_factory.mktemp('soak')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('startracker_evaluation.harness.soak.LOOP_FRAMES', 2 * FRAMES)
        # Less than the fastest machine needs for half of the frames.
        patch.setattr('startracker_evaluation.harness.soak._SAMPLE_PERIOD_S', 0.02)
        with Soak(folder, seed=3) as soak:
            return soak.run(FRAMES)


def test_every_frame_is_answered_and_none_wrong(result):
    assert (result.frames, result.processed, result.lost, result.wrong) == (FRAMES, FRAMES, 0, 0)
    assert result.attitudes >= 0.99 * FRAMES


def test_no_handle_and_no_thread_is_left_behind(result):
    for node in NODES:
        begin, first, *_, last = result.samples[node]
        assert last.handles <= first.handles and last.threads <= first.threads, (node, result)
        assert 1 < last.private_mib < 1000 and last.cpu_s > begin.cpu_s


def test_the_table_has_a_row_for_each_figure(result):
    rows = {row.case: row for row in rows_of(result)}
    assert all(f'{node}: growth in 100,000 frames' in rows for node in NODES)
    assert rows['wrong attitudes'].holds and rows['frames without answer'].holds


def test_growth_is_found_where_there_is_some():
    frames = np.arange(0, 100_000, 500)
    noise = np.random.default_rng(1).normal(0, 1, len(frames))
    slope, error = growth(frames / 1e5, 150 + 20 * frames / 1e5 + noise)
    assert abs(slope - 20) < 2 * error < 4
    slope, error = growth(frames / 1e5, 150 + noise)
    assert abs(slope) < 2 * error
