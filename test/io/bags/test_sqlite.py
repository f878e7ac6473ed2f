# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of the storage sqlite3, written by rosbags as an outside oracle."""

import ctypes
from pathlib import Path
import shutil
import sqlite3
import subprocess
import sys

from limits import HANGS_S
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.reader import read_blocks_ns, read_messages, read_span_ns, read_topics
from startracker_ros.io.bags.recovery import recover
from startracker_ros.io.bags.schemas import message_schema

COUNT = 100
TYPES = {'/a': 'std_msgs/msg/Header', '/b': 'geometry_msgs/msg/Vector3'}


def write(folder: Path, compression: CompressionMode | None = None) -> Path:
    """Write numbered messages of two topics in turn, all of one size."""
    typestore = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = [writer.add_connection(topic, name, typestore=typestore)
                       for topic, name in TYPES.items()]
        for number in range(COUNT):
            writer.write(connections[number % 2], number * 10 ** 8, bytes([number]) * 900)
    return folder


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write(tmp_path / 'run')


def numbers(path: Path, **options: object) -> list[int]:
    return [message.data[0] for message in read_messages(path, **options)]


def test_a_bag_of_another_writer_is_read(bag: Path) -> None:
    for path in (bag, next(bag.glob('*.db3'))):
        assert numbers(path) == list(range(COUNT))
        assert numbers(path, topics=('/b',), start_ns=10 ** 9, end_ns=2 * 10 ** 9) == [
            11, 13, 15, 17, 19]
        assert read_span_ns(path) == (0, (COUNT - 1) * 10 ** 8)
        assert read_blocks_ns(path) == [read_span_ns(path)]
        topics = read_topics(path)
        assert {name: topic.type_name for name, topic in topics.items()} == TYPES
        assert {topic.message_count for topic in topics.values()} == {COUNT // 2}
        assert all(topic.encoding == 'cdr' and topic.schema.encoding == 'ros2msg'
                   and topic.schema.type_hash == message_schema(topic.type_name).type_hash
                   for topic in topics.values())


@pytest.mark.parametrize('mode', [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compressed_messages_and_files_are_read(tmp_path: Path, mode: CompressionMode) -> None:
    bag = write(tmp_path / 'run', mode)
    assert numbers(bag) == list(range(COUNT))
    result, problems = describe(bag)
    assert problems == []
    assert result.conditions['compression'] == (
        'zstd, whole files' if mode is CompressionMode.FILE else 'zstd, each message')


def test_without_metadata_it_is_read_and_turned_into_an_mcap_bag(bag: Path, tmp_path: Path
                                                                 ) -> None:
    (bag / 'metadata.yaml').unlink()
    assert recover(bag, tmp_path / 'new', report=pytest.fail) == COUNT
    assert numbers(tmp_path / 'new') == list(range(COUNT))
    assert read_topics(tmp_path / 'new') == read_topics(bag)


def test_the_tables_of_the_first_schema_are_read(tmp_path: Path) -> None:
    file = tmp_path / 'old.db3'
    with sqlite3.connect(file) as database:
        database.executescript(
            'CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, '
            'serialization_format TEXT NOT NULL); CREATE TABLE messages(id INTEGER PRIMARY KEY, '
            'topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL); '
            "INSERT INTO topics VALUES(7, '/a', 'std_msgs/msg/Header', 'cdr');")
        database.executemany('INSERT INTO messages VALUES(NULL, 7, ?, ?)',
                             [(5, b'2'), (3, b'0'), (3, b'1')])
    database.close()
    assert [message.data for message in read_messages(file)] == [b'0', b'1', b'2']
    assert read_topics(file)['/a'].schema.type_hash == ''


def without_right_to_write() -> None:
    """Take from root, as which tests may run, the right to write where the mode forbids it."""
    drop_from_bounding_set, dac_override = 24, 1
    ctypes.CDLL(None).prctl(drop_from_bounding_set, dac_override, 0, 0, 0)


@pytest.mark.parametrize('left', [(), ('-wal',), ('-wal', '-shm')], ids=str)
def test_a_bag_in_wal_mode_is_read_where_nothing_can_be_written(bag: Path, tmp_path: Path,
                                                                left: tuple[str, ...]) -> None:
    source, folder = next(bag.glob('*.db3')), tmp_path / 'disk'
    database = sqlite3.connect(source)
    database.execute('PRAGMA journal_mode = WAL')
    # Messages that are in the log only, as a killed recorder leaves them.
    database.execute('UPDATE messages SET timestamp = timestamp + 1')
    database.commit()
    if not left:
        database.close()
    folder.mkdir()
    for end in ('', *left):
        shutil.copy(f'{source}{end}', folder / f'run.db3{end}')
    files = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert read_span_ns(folder) == (1, (COUNT - 1) * 10 ** 8 + 1)
    assert describe(folder)[1] == []
    assert {path.name for path in folder.iterdir()} == files.keys()
    folder.chmod(0o555)
    code = ('import sys; from pathlib import Path; from startracker_ros.io.bags import reader; '
            'folder = Path(sys.argv[1]); '
            'print(sum(1 for _ in reader.read_messages(folder)), reader.read_span_ns(folder)); '
            '(folder / "new").touch()')
    done = subprocess.run(
        [sys.executable, '-c', code, str(folder)], capture_output=True, text=True,
        timeout=HANGS_S, preexec_fn=without_right_to_write)
    folder.chmod(0o755)
    assert done.stdout == f'{COUNT} (1, {(COUNT - 1) * 10 ** 8 + 1})\n', done.stderr
    assert 'PermissionError' in done.stderr
    assert {path.name for path in folder.iterdir()} == files.keys()
    database.close()


def test_damage_is_reported_after_what_is_intact(bag: Path) -> None:
    file = next(bag.glob('*.db3'))
    data = bytearray(file.read_bytes())
    data[len(data) // 2:len(data) // 2 + 8192] = bytes(8192)
    file.write_bytes(data)
    with pytest.raises(BagError, match='run.db3 is damaged: '):
        numbers(bag)
    problems: list[str] = []
    found = numbers(bag, tolerant=True, report=problems.append)
    assert 10 < len(found) < COUNT and found == list(range(len(found)))
    assert len(problems) == 1 and 'is damaged' in problems[0]


@pytest.mark.parametrize('script, words', [
    ('CREATE TABLE other(id INTEGER)', 'is not a bag: it has the tables other'),
    ('CREATE TABLE topics(id INTEGER); CREATE TABLE messages(id INTEGER);'
     'INSERT INTO topics VALUES(1)', "is damaged: 'type'"),
    # The rows of a view would be computed by the file.
    ('CREATE TABLE messages(id INTEGER); CREATE VIEW topics AS SELECT 1 AS id',
     'is not a bag: it has the tables messages')])
def test_other_databases_are_rejected(tmp_path: Path, script: str, words: str) -> None:
    with sqlite3.connect(tmp_path / 'run.db3') as database:
        database.executescript(script)
    database.close()
    for tolerant in (False, True):
        with pytest.raises(BagError, match=words):
            numbers(tmp_path / 'run.db3', tolerant=tolerant)


def test_a_message_that_is_invalid_is_damage(bag: Path) -> None:
    with sqlite3.connect(next(bag.glob('*.db3'))) as database:
        database.execute("UPDATE messages SET data = 'text' WHERE id = 20")
    database.close()
    with pytest.raises(BagError, match='is damaged: a message of str at '):
        numbers(bag)
