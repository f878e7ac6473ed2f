"""The fault matrix: real processes are killed, stopped and misled, and recover by themselves."""

from pathlib import Path
import shutil
import tempfile

from rich.progress import track as progress
from startracker_ros.figures import WRONG_ARCSEC, WRONG_SIGMAS
from startracker_ros.harness.faults import faults, inject, row_of, Times
from startracker_ros.harness.flight import Flight
from startracker_ros.table import Result

NAMES = tuple(faults(Times()))


def run_faults_campaign(*, seed: int, only: tuple[str, ...] = (), times: Times = Times()
                        ) -> Result:
    """Do each fault to one and the same pipeline; RigError when it does not come up."""
    rows = []
    # Kept when a row does not hold: the logs of the nodes are in it.
    folder = Path(tempfile.mkdtemp(prefix='startracker_faults_'))
    with Flight(folder, seed=seed) as flight:
        for name in progress(only or tuple(faults(times)), 'faults', transient=True):
            rows.append(row_of(name, inject(flight, name, times)))
    well = all(row['holds'] for row in rows)
    if well:
        shutil.rmtree(folder)
    return Result('campaign faults', rows, {
        'pipeline': 'four stages and a recorder, a process each; images of 512 x 512 px, 12 deg, '
                    '10 Hz, turning at 0.11 deg/s',
        'recovery_s': 'from what recovery_from says to the attitude of the first of five frames '
                      'in a row that have one, or to a recorder that records',
        'longest_gap_s': 'longest time without an attitude, the fault itself included',
        'wrong': f'off by more than {WRONG_SIGMAS:g} sigma of its own covariance and '
                 f'{WRONG_ARCSEC:g} arcsec on any axis, among all published during the fault and '
                 'after it',
        'disk': 'no file of the recorder may grow (RLIMIT_FSIZE), until it may again',
        **({} if well else {'logs and bags': str(folder)}), 'seed': seed})
