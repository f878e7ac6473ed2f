# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The file of a bag by its first bytes: MCAP or SQLite."""

from startracker_ros.io.bags.compression import first_unpacked_bytes, ZSTD_MAGIC
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.mcap_file import McapFile
from startracker_ros.io.bags.remote import BagPath, RemotePath
from startracker_ros.io.bags.sqlite_file import SQLITE_MAGIC, SqliteFile

_HEAD_BYTES = 2 ** 18

BagFile = McapFile | SqliteFile


def open_file(path: BagPath) -> BagFile:
    """Open a file of a bag; BagError if it cannot be read or is of no storage of rosbag2."""
    if isinstance(path, RemotePath):
        # SQLite reads files of this machine only.
        return McapFile(path)
    try:
        with path.open('rb') as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error
    if head.startswith(ZSTD_MAGIC):
        head = first_unpacked_bytes(head, len(SQLITE_MAGIC))
    return SqliteFile(path) if head.startswith(SQLITE_MAGIC) else McapFile(path)
