# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The campaign of the closed loop: its faults, its rows, and the first seconds of a run."""

from dataclasses import replace

import numpy as np
from startracker_evaluation.campaign.closed_loop import Faults, row_of, run, RunResult

GOOD = RunResult(frames=2000, fine=True, in_control=True, wrong=0, gross=0, used=1800,
                 settle_s=20.0, rms_arcsec=(0.4, 0.5, 5.0), hold_s=30.0, wall_s=20.0)


def test_every_fault_occurs_as_often_as_stated():
    drawn = []
    for seed in range(10):
        faults = Faults(1200.0, np.random.default_rng(seed))
        drawn += [faults.fault(0.2 * index) for index in range(6000)]
    shares = [np.mean([getattr(fault, name) != 0 for fault in drawn])
              for name in ('dropped', 'torn', 'blinded', 'offset_s')]
    # 5 % and 4 s, 2 %, 25 s at most of overlapping bursts, 1 % and 40 s of 20 minutes.
    assert np.abs(np.array(shares) - [0.053, 0.02, 0.02, 0.043]).max() < 0.01
    assert {fault.offset_s for fault in drawn} == {-0.05, 0.0, 0.05}


def test_a_row_holds_only_if_every_run_does():
    assert row_of('quiet, star lists', [[GOOD], [GOOD]]).holds
    for bad in (replace(GOOD, fine=False), replace(GOOD, in_control=False),
                replace(GOOD, wrong=1), replace(GOOD, settle_s=np.inf),
                replace(GOOD, rms_arcsec=(0.4, 2.5, 5.0))):
        row = row_of('quiet, star lists', [[GOOD], [bad]])
        assert not row.holds
        assert row.runs == 2


def test_pointing_is_bounded_without_faults_only():
    assert row_of('faults, star lists', [[replace(GOOD, rms_arcsec=(9.0, 9.0, 9.0))]]).holds


def test_a_tumbling_spacecraft_with_faults_is_stopped(basilisk):
    result, = run('faults, star lists', 4, hours=20 / 3600)
    assert result.frames == 100
    assert result.wrong == 0
    assert result.used > 50
