"""Every fault of the matrix, shorter than the campaign has it, on one running pipeline."""

import pytest
from startracker_ros.harness.faults import faults, row_of, Times
from startracker_ros.harness.flight import Flight

TIMES = Times(blind_s=6.0, stopped_s=4.0, dead_s=2.0, frames_s=2.0, orders=1)


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    """Return a pipeline of real processes and its sky."""
    with Flight(tmp_path_factory.mktemp('flight'), seed=2) as flight:
        yield flight


@pytest.mark.parametrize('name', faults(TIMES))
def test_the_nodes_recover_from(flight, name):
    row = row_of(flight, name, TIMES, patience_s=60.0)
    assert row['recovery_s'] is not None, row
    assert row['wrong'] == 0 and row['attitudes'] > 0, row
    # Later than in the campaign may be, on a machine that runs other tests beside.
    assert row['holds'] or row['recovery_s'] > row['bound_s'], row
