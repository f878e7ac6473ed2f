# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Folders that the package writes to unasked."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain
import os
from pathlib import Path
import tempfile
from typing import BinaryIO
from uuid import uuid4

DATABASES = 'pairs-*', 'catalogue-*', 'quads-*'
"""Names of the files of pattern databases in the cache folder."""

MAX_DATABASE_BYTES = 1_600_000_000
"""Size of the pattern databases in the cache folder: a search of all fields of view has
1180 MB, a camera up to 170 MB."""


def cache_folder() -> Path:
    """Return the package's folder in the user's cache; XDG_CACHE_HOME is respected."""
    root = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(root) / 'startracker_ros'


def stored_databases(folder: Path) -> list[tuple[Path, int]]:
    """Return the files of pattern databases in a folder and their bytes, last used first."""
    found = []
    # With those of processes that were killed while they wrote.
    for file in chain(*map(folder.glob, DATABASES)):
        # Another process may delete one meanwhile.
        with suppress(FileNotFoundError):
            status = file.stat()
            found.append((status.st_atime_ns, file, status.st_size))
    return [(file, size) for _, file, size in sorted(found, reverse=True)]


@contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """
    Yield a new file, open to write and read, that replaces the one at path when it is complete.

    Another process never reads a partial file. Its folder is made. OSError where that fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f'{path.stem}-{uuid4().hex}.part')
    try:
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
