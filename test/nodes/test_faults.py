"""Every fault of the matrix, shorter than the campaign has it, on one running pipeline."""

import pytest
from startracker_ros.harness.faults import faults, inject, Times
from startracker_ros.harness.flight import Flight

TIMES = Times(blind_s=6.0, stopped_s=4.0, dead_s=2.0, frames_s=2.0, orders=1)


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    """Return a pipeline of real processes and its sky."""
    with Flight(tmp_path_factory.mktemp('flight'), seed=2) as flight:
        yield flight


@pytest.mark.parametrize('name', faults(TIMES))
def test_the_nodes_recover_from(flight, name):
    """How soon they do is a figure of the campaign; here a limit only means never."""
    outcome = inject(flight, name, TIMES, patience_s=120.0)
    assert outcome.attitudes > 0
    assert outcome.wrong == 0
    assert outcome.expected.problem == ''
    assert outcome.said is not None, outcome.expected.diagnostics
    assert outcome.recovery_s is not None
