# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One SQLite file of a bag, as the storage sqlite3 of rosbag2 writes it (schema 1 to 4)."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import sqlite3
from types import TracebackType
from typing import Any
from urllib.parse import quote

from mcap.records import Channel, Schema
import numpy as np
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.storage import (
    absolute, by_channel, MAX_RECORD_BYTES, RawMessage, unpack_file, ZSTD_MAGIC)
import zstandard

SQLITE_MAGIC = b'SQLite format 3\0'
_LAST_NS = 2 ** 63 - 1
# The byte of the header that is 2 in WAL mode.
_WRITE_VERSION, _WAL = 18, b'\x02'
# Of a file from elsewhere: no functions of its schema, no cells beyond their page.
_PRAGMAS = ('trusted_schema = OFF', 'cell_size_check = ON', 'query_only = ON')


class SqliteFile:
    """
    An open SQLite file, read as McapFile is; its messages have one time, that of reception.

    SQLite checks a page when it reads it, so damage appears while messages are read.
    """

    is_sound = True

    def __init__(self, path: Path) -> None:
        """Open the file; BagError if it is not a bag."""
        self.path = Path(path)
        self.compressions: set[str] = set()
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self._unpacked: Any = None
        try:
            # A generator may end in another thread than it began in.
            database = self._unpacked_path()
            access, locking_mode = _access(database)
            self._database = sqlite3.connect(
                f'file:{quote(database)}?{access}', uri=True, check_same_thread=False)
        except (OSError, ValueError, sqlite3.Error, zstandard.ZstdError) as error:
            raise BagError(f'cannot read {path}: {error}') from error
        try:
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
            for pragma in (*_PRAGMAS, f'locking_mode = {locking_mode}'):
                self._database.execute(f'PRAGMA {pragma}')
            self._read_topics()
        except (sqlite3.Error, KeyError, TypeError, ValueError) as error:
            self._close()
            raise self._error(error) from error
        except BaseException:
            self._close()
            raise

    def _unpacked_path(self) -> str:
        """Return the path of the database, in a temporary file where it is compressed."""
        with open(self.path, 'rb') as file:
            self.compressed_file = file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
            if not self.compressed_file:
                return str(self.path.absolute())
            file.seek(0)
            self._unpacked = unpack_file(file)
            return self._unpacked.name

    def _close(self) -> None:
        self._database.close()
        if self._unpacked is not None:
            self._unpacked.close()

    def __enter__(self) -> 'SqliteFile':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._close()

    @property
    def message_counts(self) -> dict[int, int]:
        """Numbers of messages by channel; BagError of a damaged file."""
        return dict(self._rows('SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id'))

    def log_times(self) -> dict[int, np.ndarray]:
        """Return the log times (N,) of the messages of each channel; BagError at damage."""
        return by_channel((number, [time_ns]) for number, time_ns in self._rows(
            "SELECT topic_id, timestamp FROM messages WHERE typeof(timestamp) = 'integer' AND "
            'timestamp >= 0'))

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time; None without messages."""
        (start_ns, end_ns), = self._rows('SELECT MIN(timestamp), MAX(timestamp) FROM messages')
        return None if start_ns is None else (start_ns, end_ns)

    @property
    def blocks_ns(self) -> list[tuple[int, int]]:
        """First and last log time of the file, which has no chunks."""
        span_ns = self.span_ns
        return [] if span_ns is None else [span_ns]

    def check(self) -> None:
        """Do nothing: a file that could be opened is sound as far as SQLite knows."""

    def messages(self, topics: Sequence[str] = (), start_ns: int = 0, *,
                 report: Callable[[str], None] | None = None) -> Iterator[RawMessage]:
        """
        Yield messages in the order of their log times; BagError at the damage.

        With report, damage is reported and ends the messages.
        """
        wanted = [number for number, channel in self.channels.items()
                  if not topics or channel.topic in topics]
        try:
            for number, time_ns, data in self._rows(
                    'SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND '
                    f'topic_id IN ({",".join("?" * len(wanted))}) ORDER BY timestamp, id',
                    (min(start_ns, _LAST_NS), *wanted)):
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    raise self._error(f'a message of {type(data).__name__} at {time_ns!r}')
                channel = self.channels[number]
                yield RawMessage(channel, self.schemas.get(channel.schema_id), time_ns, time_ns,
                                 data)
        except BagError as error:
            if report is None:
                raise
            report(str(error))

    def intact_messages(self, report: Callable[[str], None]) -> Iterator[RawMessage]:
        """Yield the messages before the first damage; report() it."""
        return self.messages(report=report)

    def _rows(self, query: str, values: Sequence[int] = ()) -> Iterator[tuple]:
        try:
            yield from self._database.execute(query, values)
        except sqlite3.Error as error:
            raise self._error(error) from error

    def _read_topics(self) -> None:
        """Read the tables of topics and definitions; older schemas have fewer columns."""
        tables = {name for name, text in self._rows(
            "SELECT name, sql FROM sqlite_master WHERE type = 'table'")
            if str(text).startswith('CREATE TABLE')}
        if not {'topics', 'messages'} <= tables:
            raise BagError(f'{self.path} is not a bag: it has the tables '
                           f'{", ".join(sorted(tables)) or "of none"}')
        definitions = {} if 'message_definitions' not in tables else {
            row['topic_type']: row for row in self._records('message_definitions')}
        for number, row in enumerate(self._records('topics'), 1):
            name, definition = str(row['type']), definitions.get(row['type'], {})
            self.schemas[number] = Schema(
                number, str(definition.get('encoded_message_definition', '')).encode(),
                str(definition.get('encoding', '')), name)
            self.channels[int(row['id'])] = Channel(
                int(row['id']), absolute(str(row['name'])), str(row['serialization_format']), {
                    'offered_qos_profiles': str(row.get('offered_qos_profiles', '')),
                    'topic_type_hash': str(row.get('type_description_hash', ''))}, number)

    def _records(self, table: str) -> Iterator[dict]:
        cursor = self._database.execute(f'SELECT * FROM {table}')
        names = [column[0] for column in cursor.description]
        return (dict(zip(names, row)) for row in cursor)

    def _error(self, reason: object) -> BagError:
        return BagError(f'{self.path} is damaged: {reason}')


def _access(database: str) -> tuple[str, str]:
    """
    Return parameters of the URI and the locking mode that leave no file next to a database.

    In WAL mode SQLite writes NAME-wal and NAME-shm there even to read it, and does not remove
    them again. It does not need them where the recorder has ended and its log is merged or can be
    indexed in memory; where both files are there a recorder may be running, and its locks count.
    """
    with open(database, 'rb') as file:
        file.seek(_WRITE_VERSION)
        is_wal = file.read(1) == _WAL
    log, index = (Path(f'{database}-{end}') for end in ('wal', 'shm'))
    has_log = is_wal and log.is_file() and log.stat().st_size > 0
    if not is_wal or has_log and index.is_file():
        return 'mode=ro', 'NORMAL'
    # Only without other connections, hence without locks, SQLite keeps the index in memory.
    return ('mode=ro&vfs=unix-none', 'EXCLUSIVE') if has_log else ('immutable=1', 'NORMAL')
