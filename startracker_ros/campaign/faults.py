"""The fault matrix: processes that are killed, stopped or fed bad data have to recover."""

from pathlib import Path
import shutil
import tempfile

from rich.progress import track as progress
from startracker_ros.figures.correctness import WRONG_TEXT
from startracker_ros.harness.faults import faults, inject, row_of, Times
from startracker_ros.harness.flight import Flight
from startracker_ros.table import Result

NAMES = tuple(faults(Times()))


def run_faults_campaign(*, seed: int, only: tuple[str, ...] = (), times: Times = Times()
                        ) -> Result:
    """Inject each fault into the same pipeline; RigError when it does not start."""
    rows = []
    # It holds the logs of the nodes and is deleted only when all rows hold.
    folder = Path(tempfile.mkdtemp(prefix='startracker_faults_'))
    with Flight(folder, seed=seed) as flight:
        for name in progress(only or tuple(faults(times)), 'faults', transient=True):
            rows.append(row_of(name, inject(flight, name, times)))
    all_hold = all(row['holds'] for row in rows)
    if all_hold:
        shutil.rmtree(folder)
    return Result('campaign faults', rows, {
        'pipeline': 'four stages and a recorder, a process each; images of 512 x 512 px, 12 deg, '
                    '10 Hz, turning at 0.11 deg/s',
        'recovery_s': 'from what recovery_from says to the attitude of the first of five frames '
                      'in a row that have one, or to a recorder that records',
        'longest_gap_s': 'longest time without an attitude, the fault itself included',
        'wrong': f'{WRONG_TEXT}, among all published during the fault and after it',
        'disk': 'no file of the recorder may grow (RLIMIT_FSIZE), until it may again',
        **({} if all_hold else {'logs and bags': str(folder)}), 'seed': seed})
