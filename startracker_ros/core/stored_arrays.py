# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Arrays that are built once, and then mapped from files in the user's cache.

Processes that map the same file share its memory, and hold the part that they have read. A search
of many databases gives back what it has not used for longest, beyond MOST_RESIDENT_BYTES.

A file is read in place, by C as well (native/src/sky/sections.h): a header, a table of sections
and the arrays, each aligned to 64 bytes, in the byte order of the machine that wrote it.
"""

from collections.abc import Callable
from contextlib import suppress
from functools import cache
import hashlib
import logging
import mmap
from multiprocessing.util import Finalize
import os
from pathlib import Path
import struct
from threading import Lock
from typing import BinaryIO
from weakref import WeakKeyDictionary, WeakValueDictionary
import zlib

import numpy as np
from startracker_ros.core.folders import cache_folder, limit_cache, mark_used, replaced

FORMAT = 5
"""
Of all stored arrays: their layout in a file, and what their builders put into them.

To be raised with every change of either, so that no file of before is read: with what it is built
from it is the key of a file. A test compares what is built with what was recorded for FORMAT.
"""

MOST_RESIDENT_BYTES = 200_000_000
"""Size of the mapped files that a search of many databases keeps in memory."""

# What it is, BYTE_ORDER, CRC of all that follows it, size of the file, LAYOUT, number of sections.
_HEADER = struct.Struct('=8sIIQII32x')
_UNCHECKED = 16
# Name and type as of NumPy without the byte order, offset, shape, number of dimensions.
_SECTION = struct.Struct('=24s8sQ2QI4x')
_MAGIC, _BYTE_ORDER, _LAYOUT = b'STARRAYS', 0x01020304, 1
_ALIGNMENT = 64
_CHUNK = 1 << 20
# MADV_POPULATE_READ of Linux 5.14.
_POPULATE = 22

# Files that this process has written, or read and found sound: what identifies them by path.
_sound: dict[Path, tuple[int, ...]] = {}
_lock = Lock()


class StoredArrays:
    """
    Arrays by name, mapped from a file, or in memory where no file can be written.

    They can be written to, but must not.
    """

    def __init__(self, arrays: dict[str, np.ndarray], mapped: mmap.mmap | None = None) -> None:
        self.arrays = arrays
        self._mapped = mapped

    @property
    def mapped_bytes(self) -> int:
        """Return the size of the mapped file, 0 without one."""
        return 0 if self._mapped is None else len(self._mapped)

    def populate(self) -> None:
        """Map the whole file at once: in a short search, faults of pages would take long."""
        # Of the largest files a short search reads a small part.
        if self._mapped is not None and len(self._mapped) <= MOST_RESIDENT_BYTES // 2:
            # Older systems map the pages when they are used.
            with suppress(OSError):
                self._mapped.madvise(_POPULATE)

    def give_back(self) -> None:
        """Give the pages of the file back; they are read again when they are used."""
        if self._mapped is not None:
            self._mapped.madvise(mmap.MADV_DONTNEED)


# Files that are mapped now, and all that this process has used, the first one at the beginning.
_mapped: WeakValueDictionary[Path, StoredArrays] = WeakValueDictionary()
_used: dict[Path, None] = {}
# With pages in memory, the one last used at the end.
_resident: WeakKeyDictionary[StoredArrays, None] = WeakKeyDictionary()


def prepare(*used: StoredArrays) -> None:
    """
    Have the pages of arrays in memory that are about to be used.

    Give back those that were prepared the longest ago, beyond MOST_RESIDENT_BYTES.
    """
    with _lock:
        new = [stored for stored in used if stored not in _resident]
        for stored in used:
            _resident.pop(stored, None)
            _resident[stored] = None
        excess = resident_bytes() - MOST_RESIDENT_BYTES
        for stored in list(_resident) if excess > 0 else ():
            if excess <= 0 or stored in used:
                break
            excess -= stored.mapped_bytes
            del _resident[stored]
            stored.give_back()
        for stored in new:
            stored.populate()


def resident_bytes() -> int:
    """Return the size of the mapped files of which this process has pages at most."""
    return sum(stored.mapped_bytes for stored in list(_resident))


def digest(*parts: object) -> str:
    """Return a digest of arrays, and of other values by their representation."""
    made_of = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            made_of.update(np.ascontiguousarray(part).data)
        else:
            made_of.update(repr(part).encode())
    return made_of.hexdigest()


def stored_arrays(kind: str, key: str, build: Callable[[], dict[str, np.ndarray]]
                  ) -> StoredArrays:
    """
    Return the arrays of a kind and a key from the cache, or build and store them.

    key is that of all that build() depends on, except for the code: FORMAT is of that.
    A file that does not match its checksum is rebuilt. Where the folder cannot be written, the
    arrays are built each time. The last used files remain, as limit_cache() has it.
    """
    path = cache_folder() / f'{kind}-{digest(FORMAT, key)[:32]}.bin'
    stored = _load(path)
    if stored is None:
        arrays = build()
        stored = _store(path, arrays) or StoredArrays(arrays)
    return stored


class StoredArraysError(ValueError):
    """A file has no arrays that can be used; the text names it and says why."""


def mapped_arrays(path: Path) -> StoredArrays:
    """Return the arrays of a file; StoredArraysError where it is not sound, OSError."""
    with path.open('rb') as file:
        wrong = _why_not_sound(file)
        if wrong:
            raise StoredArraysError(f'{path}: {wrong}')
        return _map(file)


def _load(path: Path) -> StoredArrays | None:
    try:
        with path.open('rb') as file:
            identity = _identity(file)
            if _sound.get(path) != identity:
                if _why_not_sound(file):
                    logging.getLogger(__name__).warning('%s is damaged and is rebuilt', path)
                    return None
                _sound[path] = identity
            mark_used(file.fileno())
            return _in_use(path, _map(file))
    except OSError:
        return None


def _identity(file: BinaryIO) -> tuple[int, ...]:
    """Return what no other file has: its use changes only the time of access."""
    status = os.fstat(file.fileno())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _why_not_sound(file: BinaryIO) -> str:
    """Return what is wrong with a file of arrays, read from its beginning; empty if nothing is."""
    head = file.read(_HEADER.size)
    if not head.startswith(_MAGIC) or len(head) < _HEADER.size:
        return 'it is not a file of this package'
    _, order, checksum, size, layout, _ = _HEADER.unpack(head)
    if order != _BYTE_ORDER or layout != _LAYOUT:
        return 'it was written by another version, or on a machine of another byte order'
    if size != os.fstat(file.fileno()).st_size:
        return f'it does not have the {size} bytes that were written'
    # By reading, not through the map, whose pages would stay in memory.
    found = zlib.crc32(head[_UNCHECKED:])
    while chunk := file.read(_CHUNK):
        found = zlib.crc32(chunk, found)
    return '' if found == checksum else 'it is damaged'


def _in_use(path: Path, stored: StoredArrays) -> StoredArrays:
    """Note that the arrays of a file are in use, and return them."""
    _mapped[path] = stored
    _used.setdefault(path)
    return stored


@cache
def _limit_at_the_end() -> None:
    """
    Count at the end of this process what it has used, which has the most room.

    Not before: a search of more databases than there is room for would delete each one before its
    next use.
    """
    # Of processes of a pool as well, which atexit does not know.
    Finalize(None, lambda: limit_cache(first=_used), exitpriority=0)


def _map(file: BinaryIO) -> StoredArrays:
    """Return the arrays of a sound file."""
    buffer: mmap.mmap | bytearray
    try:
        # Private, hence writable like any other array.
        buffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except OSError:
        # A file system that maps no files.
        file.seek(0)
        buffer = bytearray(file.read())
    *_, count = _HEADER.unpack(buffer[:_HEADER.size])
    arrays = {}
    for name, kind, offset, rows, columns, dimensions in _SECTION.iter_unpack(
            buffer[_HEADER.size:_HEADER.size + count * _SECTION.size]):
        arrays[name.rstrip(b'\0').decode()] = np.ndarray(
            (rows, columns)[:dimensions], kind.rstrip(b'\0').decode(), buffer, offset)
    return StoredArrays(arrays, buffer if isinstance(buffer, mmap.mmap) else None)


def _store(path: Path, arrays: dict[str, np.ndarray]) -> StoredArrays | None:
    """Store arrays and return them as mapped from the file, None where none can be written."""
    try:
        with replaced(path) as file:
            write_arrays(file, arrays)
            stored, identity = _map(file), _identity(file)
        _sound[path] = identity
        _in_use(path, stored)
        limit_cache(uncounted=set(_mapped))
        _limit_at_the_end()
    except OSError as error:
        logging.getLogger(__name__).warning(
            'pattern database is not cached in %s: %s', path.parent, error.strerror)
        return None
    return stored


def write_arrays(file: BinaryIO, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays of two dimensions at most to a file, open to write and read."""
    end = _HEADER.size + len(arrays) * _SECTION.size
    table = b''
    for name, array in arrays.items():
        shape = (*array.shape, 0, 0)[:2]
        table += _SECTION.pack(name.encode(), array.dtype.str[1:].encode(), end, *shape,
                               array.ndim)
        end = _aligned(end + array.nbytes)
    pieces: list[memoryview | bytes] = [table]
    for array in arrays.values():
        content = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        pieces += [content.data, bytes(_aligned(array.nbytes) - array.nbytes)]
    head = _MAGIC, _BYTE_ORDER, 0, end, _LAYOUT, len(arrays)
    checksum = zlib.crc32(_HEADER.pack(*head)[_UNCHECKED:])
    file.write(bytes(_HEADER.size))
    for piece in pieces:
        checksum = zlib.crc32(piece, checksum)
        file.write(piece)
    file.seek(0)
    file.write(_HEADER.pack(*head[:2], checksum, *head[3:]))
    file.flush()


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
