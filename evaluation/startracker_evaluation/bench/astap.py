# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
ASTAP (https://www.hnsky.org/astap.htm) on whole images, by its command astap_cli.

On Debian the package astap-cli. Debian has none of its star databases: it gets one with the stars
of this package, in its two formats, of 290 areas and, for fields above 20 deg, of the whole sky.
The formats are described in the comments of its source, unit_command_line_star_database.pas.
"""

from functools import partial
from pathlib import Path
import re
import resource
import shutil
import subprocess
import tempfile

import cv2
import numpy as np
from startracker_evaluation.bench.astrometry_net import children_cpu_s, CPU_LIMIT_S
from startracker_ros.core.catalog.deep import load_deep_catalog
from startracker_ros.core.maths.rotation import radec_from_unit, unit_from_radec

ASTAP = 'ASTAP'
COMMAND = 'astap_cli'
_HANGS_S = 600
_EPOCH_YEAR = 2019.5

# Areas of each ring of declination, from the south pole on, of equal size but for the poles.
_AREAS = np.array([1, 4, 8, 12, 16, 20, 24, 28, 32, 32, 28, 24, 20, 16, 12, 8, 4, 1])
_HEADER_BYTES, _RECORD_BYTES = 110, 5
_NEW_GROUP = 0xFFFFFF  # as right ascension: magnitude and high byte of the declinations follow
_RA_STEPS, _DEC_STEPS = 2 ** 24 - 1, 2 ** 23 - 1
_WIDEST_LIMIT = 8.0  # V of the database of the widest fields, as its name says


def is_installed() -> bool:
    """Return whether the command is there."""
    return shutil.which(COMMAND) is not None


def version() -> str:
    """Return the version, or what to install."""
    if not is_installed():
        return 'absent: apt install astap-cli'
    shown = subprocess.run([COMMAND, '-h'], capture_output=True, text=True, timeout=30).stdout
    found = re.search(r'CLI-(\S+)', shown)
    return f'{found[1] if found else "unknown"}, stars of startracker_ros'


def write_database(folder: Path) -> None:
    """Write the stars of this package as the databases v17 and w08 into a folder."""
    catalog = load_deep_catalog()
    ra, dec = radec_from_unit(catalog.directions(_EPOCH_YEAR))
    ra = ra % (2 * np.pi)
    tenths = np.rint(10 * catalog.magnitude).astype(int)
    bounds = np.arcsin(2 * np.cumsum(_equal_areas()) / _equal_areas().sum() - 1)
    ring = np.searchsorted(bounds[:-1], dec, side='right')
    cell = np.minimum((ra * _AREAS[ring] / (2 * np.pi)).astype(int), _AREAS[ring] - 1)
    for number, areas in enumerate(_AREAS):
        for area in range(areas):
            inside = (ring == number) & (cell == area)
            (folder / f'v17_{number + 1:02d}{area + 1:02d}.290').write_bytes(
                _area_file(ra[inside], dec[inside], tenths[inside]))
    bright = catalog.magnitude <= _WIDEST_LIMIT
    (folder / 'w08_0101.001').write_bytes(
        np.int32(np.count_nonzero(bright)).tobytes() + np.column_stack(
            [tenths[bright], ra[bright], dec[bright]]).astype('<f4').tobytes())


def _equal_areas() -> np.ndarray:
    """Return the numbers of the areas of each ring before pairs of them became one."""
    return np.where(_AREAS == 1, 1, 2 * _AREAS)


def _area_file(ra: np.ndarray, dec: np.ndarray, tenths: np.ndarray) -> bytes:
    """Return the stars of one area, brightest first, in groups of magnitude and declination."""
    raw_ra = np.minimum(np.rint(ra / (2 * np.pi) * _RA_STEPS).astype(int), _NEW_GROUP - 1)
    raw_dec = np.rint(dec / (np.pi / 2) * _DEC_STEPS).astype(int)
    order = np.lexsort((raw_dec, raw_dec >> 16, tenths))
    raw_ra, raw_dec, tenths = raw_ra[order], raw_dec[order], tenths[order]
    group = np.stack([tenths, raw_dec >> 16])
    first = np.concatenate([[True], (np.diff(group) != 0).any(axis=0)])[:len(raw_ra)]
    stars = _records(raw_ra, raw_dec & 0xFFFF)
    heads = _records(np.full(len(raw_ra), _NEW_GROUP),
                     (group[1] + 128) | (group[0] + 16) << 8)
    both = np.stack([heads, stars], axis=1)
    kept = np.stack([first, np.ones(len(raw_ra), bool)], axis=1)
    header = b'stars of startracker_ros'.ljust(_HEADER_BYTES - 1) + bytes([_RECORD_BYTES])
    return header + both[kept].tobytes()


def _records(ra: np.ndarray, dec: np.ndarray) -> np.ndarray:
    """Return records (N, 5) uint8 of three bytes and two, the least significant first."""
    return np.stack([ra & 255, ra >> 8 & 255, ra >> 16, dec & 255, dec >> 8], axis=1).astype(
        np.uint8)


def centre(ini: str) -> np.ndarray | None:
    """Return the direction (3,) of the image centre of a result file, None if unsolved."""
    values = dict(line.split('=', 1) for line in ini.splitlines() if '=' in line)
    if values.get('PLTSOLVD', 'F').strip() != 'T':
        return None
    return unit_from_radec(*np.radians([float(values['CRVAL1']), float(values['CRVAL2'])]))


def solve(image: np.ndarray, database: Path, high_deg: float = 0.0
          ) -> tuple[np.ndarray | None, float]:
    """
    Return the direction (3,) of the centre of an image (H, W), and the CPU time in s.

    high_deg is the height of the field; with 0 ASTAP tries fields of 9.5 to 0.37 deg. All of the
    sky is searched. The time is that of the process, at most CPU_LIMIT_S.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'image.png'
        cv2.imwrite(str(path), image)
        before_s = children_cpu_s()
        subprocess.run(
            [COMMAND, '-f', str(path), '-o', str(path.with_suffix('')), '-d', str(database),
             '-r', '180', '-fov', f'{high_deg:.4f}', '-ra', '0', '-spd', '90'],
            capture_output=True, timeout=_HANGS_S, preexec_fn=partial(
                resource.setrlimit, resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S)))
        result = path.with_suffix('.ini')
        return (centre(result.read_text(errors='replace')) if result.exists() else None,
                children_cpu_s() - before_s)
