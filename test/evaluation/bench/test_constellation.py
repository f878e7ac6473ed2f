# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The bench of a constellation: of 50 GB the store gives megabytes, the rows of a year agree."""

import pytest
from startracker_evaluation.bench import constellation


@pytest.fixture(scope='module')
def rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(constellation, 'FLIGHT_FRAMES', 1000)
        patch.setattr(constellation, '_scheduler_rows', lambda trials, rows: 400.0)
        result = constellation.run_constellation_bench(trials=1, seed=1)
    return {row['case']: row['ours'] for row in result.records}


def test_of_a_sparse_bag_little_is_read(rows):
    assert rows['sparse bag: size'] >= 50
    assert rows['sparse bag: read of the store'] < 30
    assert 0 < rows['sparse bag: requests'] < 100


def test_the_year_follows_from_the_flight(rows):
    assert rows['year: frames'] == pytest.approx(3.1536e11)
    assert rows['year: the scheduler alone'] == pytest.approx(8.76e6 / 400 / 3600)
    assert rows['10^9 frames: processors'] * rows['flight: frames'] == pytest.approx(1e9 / 3600)
    assert rows['year: processors'] == pytest.approx(315.36 * rows['10^9 frames: processors'])
    cores = rows['processors that one scheduler feeds']
    assert cores * rows['flight: frames'] == pytest.approx(400 * 36_000)
