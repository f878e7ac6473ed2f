# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled code, the cache of pattern databases, room for bags."""

from collections.abc import Iterator
from pathlib import Path
import shutil

from startracker_ros.core.folders import (
    cache_folder, can_write, MAX_DATABASE_BYTES, stored_databases)
from startracker_ros.core.machine_code import (
    machine_code_folder, missing_modules, registered_modules)
from startracker_ros.tools.doctor.check import Check

# The demo, 1024 x 1024 px at 10 Hz, writes 10 MB a second.
_BAG_BYTES_S = 10e6
_LEAST_FREE_BYTES = 2e9


def check_storage() -> Iterator[Check]:
    """Yield the checks of what is kept on disk."""
    yield check_compiled(machine_code_folder(), len(missing_modules()), len(registered_modules()))
    yield check_databases(cache_folder())
    yield check_room(Path.cwd())


def check_compiled(folder: str, missing: int, count: int) -> Check:
    """
    Return whether machine code is there, of count modules all but some that are missing.

    An empty folder means that none can be kept.
    """
    if missing and not folder:
        return Check('compiled code', 'nowhere to keep it: each process compiles anew', False,
                     'make ~/.cache writable, or set NUMBA_CACHE_DIR to a folder that is')
    if missing:
        return Check('compiled code', f'{missing} of {count} modules are not compiled: the first '
                     'start takes a minute', False, 'python -m startracker_ros.warm_up')
    return Check('compiled code', f'all {count} modules that compile')


def check_databases(folder: Path) -> Check:
    """Return whether pattern databases can be kept in the folder."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not can_write(existing):
        return Check('database cache', f'{folder} cannot be written', False,
                     'make it writable, or set XDG_CACHE_HOME')
    sizes = [size for _, size in stored_databases(folder)]
    return Check('database cache', f'{len(sizes)} pattern databases, {sum(sizes) / 1e6:.1f} of '
                                   f'at most {MAX_DATABASE_BYTES / 1e6:.0f} MB, in {folder}')


def check_room(folder: Path) -> Check:
    """Return whether a bag can be written into the folder."""
    if not can_write(folder):
        return Check('room for bags', f'{folder} cannot be written', False,
                     'record into another folder: startracker record -o FOLDER')
    free = shutil.disk_usage(folder).free
    holds = free >= _LEAST_FREE_BYTES
    return Check('room for bags', f'{free / 1e9:.1f} GB free in {folder}: '
                                  f'{free / _BAG_BYTES_S / 60:.0f} min of 1 Mpx at 10 Hz',
                 holds, '' if holds else 'make room, or record without image_raw')
