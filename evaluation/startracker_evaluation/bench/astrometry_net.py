# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
astrometry.net (https://astrometry.net) on whole images, by its command solve-field.

On Debian the packages astrometry.net and astrometry-data-tycho2; its settings are those of the
package, and the field of view is given by limits of the width.
"""

from pathlib import Path
import re
import resource
import shutil
import subprocess
import tempfile

import cv2
import numpy as np
from startracker_ros.core.maths.rotation import unit_from_radec

ASTROMETRY_NET = 'astrometry.net'
COMMAND = 'solve-field'
INDEX_FILES = Path('/usr/share/astrometry')
CPU_LIMIT_S = 10
_HANGS_S = 600
_CENTRE = re.compile(r'^Field center: \(RA,Dec\) = \((\S+), (\S+)\) deg', re.MULTILINE)


def is_installed() -> bool:
    """Return whether the command and its index files are there."""
    return shutil.which(COMMAND) is not None and any(INDEX_FILES.glob('index-*.fits'))


def version() -> str:
    """Return the version, or what to install."""
    if not is_installed():
        return f'absent: apt install {ASTROMETRY_NET} astrometry-data-tycho2'
    shown = subprocess.run([COMMAND, '--version'], capture_output=True, text=True, timeout=30)
    return (shown.stdout + shown.stderr).split()[-1]


def centre(printed: str) -> np.ndarray | None:
    """Return the direction (3,) of the image centre that the command printed, None if unsolved."""
    found = _CENTRE.search(printed)
    return None if found is None else unit_from_radec(
        *np.radians([float(found[1]), float(found[2])]))


def solve(image: np.ndarray, field_deg: tuple[float, float] | None = None
          ) -> tuple[np.ndarray | None, float]:
    """
    Return the direction (3,) of the centre of an image (H, W), and the CPU time in s.

    field_deg limits the width of the field, where it is known. The time is that of the processes
    of the command.
    """
    limits = [] if field_deg is None else [
        '--scale-units', 'degwidth', '--scale-low', str(field_deg[0]),
        '--scale-high', str(field_deg[1])]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'image.png'
        cv2.imwrite(str(path), image)
        before_s = children_cpu_s()
        try:
            printed = subprocess.run(
                [COMMAND, '--no-plots', '--dir', folder, '--cpulimit', str(CPU_LIMIT_S), *limits,
                 str(path)], capture_output=True, text=True, timeout=_HANGS_S).stdout
        except subprocess.TimeoutExpired:
            printed = ''
        return centre(printed), children_cpu_s() - before_s


def children_cpu_s() -> float:
    """Return the processor time of all processes that this one has started and that ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
