# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A campaign that was interrupted goes on with the results that it has kept."""

import numpy as np
import pytest
from startracker_ros.evaluation.campaign import parallel
from startracker_ros.evaluation.campaign.parallel import parallel_trials


def draw(calls, broken, trials, seed):
    """Return numbers; every call adds a line to a file, the third fails while broken exists."""
    with calls.open('a') as file:
        file.write(f'{seed}\n')
    if broken.exists() and seed % 1_000_003 == 4:
        raise RuntimeError('interrupted')
    return np.random.default_rng(seed).uniform(size=trials)


def test_parts_are_run_once(tmp_path, monkeypatch):
    calls, broken = tmp_path / 'calls', tmp_path / 'broken'
    monkeypatch.setattr(parallel, 'parallel_map', lambda work, pieces, **_: [
        work(*piece) for piece in pieces])

    def run(kept):
        return parallel_trials(draw, [(calls, broken)], 6, 2, 7, title='', kept=kept)[0]
    whole = run(None)
    broken.touch()
    with pytest.raises(RuntimeError):
        run(tmp_path / 'kept')
    broken.unlink()
    np.testing.assert_array_equal(run(tmp_path / 'kept'), whole)
    # Three parts without, three until the interruption, and the last one again.
    assert len(calls.read_text().split()) == 3 + 3 + 1
    np.testing.assert_array_equal(run(tmp_path / 'kept'), whole)
    assert len(calls.read_text().split()) == 7
    # Of other code, none is used.
    monkeypatch.setattr(parallel, 'origin', lambda: {'commit': 'another'})
    np.testing.assert_array_equal(run(tmp_path / 'kept'), whole)
    assert len(calls.read_text().split()) == 10
