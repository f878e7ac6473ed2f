# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shared memory segments of DDS that killed processes left behind."""

import fcntl
import os
from pathlib import Path
import re
import time

_FOLDER = Path('/dev/shm')
# Of Fast DDS 2 and of later ones.
_SEGMENT = re.compile('fast(rtps|dds)_[0-9a-f]{16}')
# A starting process creates the lock file before it locks it.
_YOUNG_S = 10.0


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
