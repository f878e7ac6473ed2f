# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fault matrix: processes that are killed, stopped or fed bad data have to recover."""

from rich.progress import track as progress
from startracker_evaluation.harness.fault_injection import inject, row_of, Times
from startracker_evaluation.harness.fault_rig import FaultRig
from startracker_evaluation.harness.faults import faults
from startracker_ros.io.table import Result
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.rig import LogFolder
from startracker_ros.tools.figures.correctness import WRONG_TEXT

_TIMES = Times()
NAMES = tuple(faults(_TIMES))


def run_faults_campaign(*, seed: int, only: tuple[str, ...] = ()) -> Result:
    """Inject each fault into the same pipeline; HarnessError when it does not work."""
    rows, functions = [], faults(_TIMES)
    logs = LogFolder('faults')
    with logs as folder, FaultRig(folder, seed=seed) as rig:
        for name in progress(only or tuple(functions), 'faults', transient=True):
            outcome = inject(rig, name, functions[name], _TIMES)
            rows.append(row_of(name, outcome))
            if outcome.recovery_s is None:
                # The next fault begins with new processes.
                rig.processes.kill(*STAGES, 'bag_recorder')
        logs.keep = not all(row['holds'] for row in rows)
    return Result('campaign faults', rows, {
        'pipeline': 'four stages and a recorder, a process each; images of 512 x 512 px, 12 deg, '
                    '10 Hz, turning at 0.11 deg/s',
        'recovery_s': 'from what recovery_from says to the attitude of the first of five frames '
                      'in a row that have one, or to a recorder that records',
        'longest_gap_s': 'longest time without an attitude, the fault itself included',
        'wrong': f'{WRONG_TEXT}, among all published during the fault and after it',
        'disk': 'no file of the recorder may grow (RLIMIT_FSIZE), until it may again',
        **({'logs and bags': str(logs.path)} if logs.keep else {}), 'seed': seed})
