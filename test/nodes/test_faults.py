# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Faults of the matrix, shorter than the campaign has them, on one running pipeline."""

from limits import HANGS_S
import pytest
from startracker_evaluation.harness.fault_injection import inject, Times
from startracker_evaluation.harness.fault_rig import FaultRig
from startracker_evaluation.harness.faults import faults

TIMES = Times(blind_s=6.0, stopped_s=4.0, dead_s=2.0, frames_s=2.0, orders=1)
# One of each kind.
SOME = ('star_tracker killed', 'attitude_estimator stopped 1 s', 'images reordered',
        'clock back 10 s', 'other camera, 640 x 480 px, 16 deg')


@pytest.fixture(scope='module')
def rig(tmp_path_factory):
    """Return a pipeline of real processes and its sky."""
    with FaultRig(tmp_path_factory.mktemp('faults'), seed=2) as rig:
        yield rig


@pytest.mark.parametrize(('name', 'fault'), [
    pytest.param(name, fault, id=name, marks=() if name in SOME else pytest.mark.long)
    for name, fault in faults(TIMES).items()])
def test_the_nodes_recover_from(rig, name, fault):
    """How soon they do is a figure of the campaign; here a limit only means never."""
    outcome = inject(rig, name, fault, TIMES, timeout_s=HANGS_S)
    assert outcome.attitudes > 0
    assert outcome.wrong == 0
    assert outcome.expected.problem == ''
    assert outcome.diagnostic is not None, outcome.expected.diagnostics
    assert outcome.recovery_s is not None
