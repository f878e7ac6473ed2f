# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the figures were measured on: sources, machine, versions, scheduling, steal time."""

from datetime import datetime, UTC
from importlib import metadata
import os
from pathlib import Path
import platform
import subprocess
import sys

import numpy as np
import psutil

PACKAGE = 'startracker_ros'

_SOURCES = Path(__file__).parents[2]
# Where modules of the packages stand in the list of code.
_PLACES = {PACKAGE: '', 'startracker_evaluation': 'evaluation'}
_PRINTING = ('io', 'tools/cli', 'tools/figures', 'evaluation/cli', 'evaluation/result_table')

_BUSY_STEAL = 0.1
_HALT_POLL = Path('/sys/module/haltpoll/parameters/guest_halt_poll_ns')


def machine(*others: str) -> str:
    """Return processor, cores and versions, then what else is given."""
    return ', '.join([platform.machine(), f'{os.cpu_count()} cores',
                      f'Python {platform.python_version()}', f'NumPy {np.__version__}', *others])


def origin() -> dict[str, object]:
    """Return where a result is from: commit and folders of the code, machine, date."""
    return {'commit': _commit(), 'machine': machine(),
            'date': datetime.now(UTC).isoformat('T', 'seconds'), 'code': _loaded_code()}


def _commit() -> str:
    """Return the commit of the sources, '+' where they were changed; of a package its version."""
    def git(*arguments: str) -> str:
        return subprocess.run(['git', *arguments], cwd=_SOURCES, text=True, capture_output=True,
                              timeout=30, check=True).stdout.strip()

    try:
        return git('rev-parse', '--short', 'HEAD') + '+' * bool(git('status', '--porcelain', '.'))
    except (OSError, subprocess.SubprocessError):
        return f'{PACKAGE} {installed_version(PACKAGE)}'


def _loaded_code() -> list[str]:
    """Return the folders of the loaded modules of the package, and the modules that measure."""
    names = [name.split('.') for name, module in sys.modules.items()
             if not hasattr(module, '__path__')]
    paths = [Path(_PLACES[package], *rest).with_suffix('.py')
             for package, *rest in names if package in _PLACES]
    return sorted({(path if path.parts[0] == 'evaluation' else path.parent).as_posix()
                   for path in paths if len(path.parts) > 1
                   and not path.as_posix().startswith(_PRINTING)})


def installed_version(package: str) -> str:
    """Return the version of a package, empty when it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        # This one may run out of its sources.
        return 'this' if package == PACKAGE else ''


def scheduling() -> str:
    """Return the priority of this process, and the sleep of idle virtual processors."""
    priority = 'normal' if os.sched_getscheduler(0) == os.SCHED_OTHER else 'real-time'
    if not _HALT_POLL.exists():
        return f'{priority} priority'
    return (f'{priority} priority, virtual processors that sleep after '
            f'{int(_HALT_POLL.read_text()) * 1e-6:g} ms')


class StealTime:
    """The share of processor time that the host gave to others since this was created."""

    def __init__(self) -> None:
        self._before = psutil.cpu_times()

    @property
    def share(self) -> float:
        """Return the share, NaN where the system does not measure it."""
        now = psutil.cpu_times()
        if not hasattr(now, 'steal'):
            return float('nan')
        stolen_s = now.steal - self._before.steal
        busy_s = now.user + now.system - self._before.user - self._before.system
        return stolen_s / max(stolen_s + busy_s, 1e-9)

    def __str__(self) -> str:
        share = self.share
        if np.isnan(share):
            return 'steal time not measured on this system'
        return f'{share:.1%} steal time'


class MachineLoad:
    """How busy the machine is from now on: load averages, steal time; it says if it is busy."""

    def __init__(self) -> None:
        self._steal = StealTime()
        self._before = os.getloadavg()[0]

    def __str__(self) -> str:
        cores = len(os.sched_getaffinity(0))
        busy = ''
        if self._before >= cores or self._steal.share >= _BUSY_STEAL:
            busy = 'busy, which the times show: '
        return (f'{busy}load {self._before:.1f} before and {os.getloadavg()[0]:.1f} after on '
                f'{cores} {"core" if cores == 1 else "cores"}, {self._steal}')
