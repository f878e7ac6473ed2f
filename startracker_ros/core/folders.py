# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Folders that the package writes to unasked."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
import logging
import os
from pathlib import Path
import tempfile
import time
from typing import BinaryIO
from uuid import uuid4

from startracker_ros.core.ctrl_c import deleted_by_ctrl_c

CACHE_VARIABLE = 'STARTRACKER_CACHE_MB'
"""Environment variable with the size of the cache folder."""

CACHE_MB = 800.0
"""Its default. A search of all fields has 350 MB of databases, one of a known field 150 more."""


def cache_folder() -> Path:
    """Return the package's folder in the user's cache; XDG_CACHE_HOME is respected."""
    root = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(root) / 'startracker_ros'


def most_cache_bytes() -> float:
    """Return the size that the cache folder may have."""
    text = os.environ.get(CACHE_VARIABLE, '')
    with suppress(ValueError):
        if text and float(text) >= 0:
            return 1e6 * float(text)
    if text:
        logging.getLogger(__name__).warning('%s = %r is not a size in MB: %g is used',
                                            CACHE_VARIABLE, text, CACHE_MB)
    return 1e6 * CACHE_MB


def cached_files(folder: Path) -> list[tuple[Path, int]]:
    """Return the files in the cache folder and their bytes, last used first."""
    found = []
    # With those of earlier versions, and of processes that were killed while they wrote.
    for file in folder.rglob('*'):
        # Another process may delete one meanwhile.
        with suppress(FileNotFoundError):
            status = file.stat()
            if not file.is_dir():
                found.append((status.st_atime_ns, file, status.st_size))
    return [(file, size) for _, file, size in sorted(found, reverse=True)]


def mark_used(file: int | Path) -> None:
    """Note that a file of the cache, or one of this descriptor, is used now."""
    # The file of another user can be read but not touched.
    with suppress(OSError):
        os.utime(file, ns=(time.time_ns(), os.stat(file).st_mtime_ns))


def limit_cache(first: Iterable[Path] = (), uncounted: Collection[Path] = ()) -> None:
    """
    Delete what the cache folder has beyond its size, the least recently used files first.

    first are the last to go, in this order; uncounted files stay whatever there is.
    """
    room, sizes = most_cache_bytes(), dict(cached_files(cache_folder()))
    for file in dict.fromkeys(one for one in (*first, *sizes) if one not in uncounted):
        if sizes.get(file, 0) <= room:
            room -= sizes.get(file, 0)
            continue
        # In the folder of another user none can be deleted.
        with suppress(OSError):
            file.unlink()


@contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """
    Yield a new file, open to write and read, that replaces the one at path when it is complete.

    Another process never reads a partial file. Its folder is made. OSError where that fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f'{path.stem}-{uuid4().hex}.part')
    try:
        with deleted_by_ctrl_c(part):
            with part.open('w+b') as file:
                yield file
            os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def can_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, by making one."""
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return False
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True
