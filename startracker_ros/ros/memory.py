# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Memory of a process: the shared one of DDS, what it gives back, what killed ones left."""

from contextlib import suppress
import ctypes
import fcntl
import os
from pathlib import Path
import re
import sys
import time

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Of Fast DDS 2 (Jazzy) and 3 (Kilted and later)."""

_IMAGES, _LISTS = 'fastdds.xml', 'fastdds_lists.xml'

_FOLDER = Path('/dev/shm')
# Of Fast DDS 2 and of later ones.
_SEGMENT = re.compile('fast(rtps|dds)_[0-9a-f]{16}')
# A starting process creates the lock file before it locks it.
_YOUNG_S = 10.0


def profile_variable() -> str:
    """Return the variable that the installed Fast DDS reads; later ones warn of the older."""
    prefixes = (*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix)
    # The package of Fast DDS 2 is fastrtps.
    later = any(Path(prefix, 'share', 'fastdds').is_dir() for prefix in prefixes if prefix)
    return PROFILE_VARIABLES[later]


def choose_segment(sends_images: bool) -> None:
    """Take a small segment of shared memory for a process without images; before rclpy.init()."""
    for variable in () if sends_images else PROFILE_VARIABLES:
        profile = Path(os.environ.get(variable, ''))
        if profile.name == _IMAGES and profile.with_name(_LISTS).is_file():
            os.environ[variable] = str(profile.with_name(_LISTS))


def return_free_memory() -> None:
    """
    Give back what was used to build.

    The environment of the nodes makes the C library keep the largest memory that a node has ever
    used.
    """
    # Of glibc only.
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def remove_left_behind(folder: Path = _FOLDER) -> int:
    """
    Remove the segments of dead processes; return their size in bytes.

    Fast DDS removes a segment only when its process exits, so that each killed node leaves 70 MB
    in /dev/shm. A process holds a lock (flock) on <segment>_el until it dies. Files of other
    users are left alone.
    """
    removed = 0
    for lock_path in folder.glob('fast*_el'):
        segment = lock_path.with_name(lock_path.name.removesuffix('_el'))
        if not _SEGMENT.fullmatch(segment.name):
            continue
        try:
            if time.time() - lock_path.stat().st_mtime < _YOUNG_S:
                continue
            lock = os.open(lock_path, os.O_RDWR | os.O_CLOEXEC)
        except OSError:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            size = segment.stat().st_size if segment.exists() else 0
            segment.unlink(missing_ok=True)
            lock_path.unlink(missing_ok=True)
            removed += size
        except OSError:
            continue
        finally:
            os.close(lock)
    return removed
