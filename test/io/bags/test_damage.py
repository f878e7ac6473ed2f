# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bad input of every kind: a clear error, bounded memory, no hang; the rest is read."""

from collections.abc import Callable
from pathlib import Path
import struct
import tracemalloc

import lz4.frame
from mcap.writer import CompressionType, Writer
import pytest
from rosbags.rosbag2 import Reader
from startracker_evaluation.bench.bag_fuzz import examine, fuzz
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.qos import qos_from_yaml, QosProfile
from startracker_ros.io.bags.reader import BagTopic, decode, read_messages, read_topics
from startracker_ros.io.bags.recovery import recover
from startracker_ros.io.bags.writer import BagOptions, BagWriter
import zstandard

TYPE = 'geometry_msgs/msg/QuaternionStamped'
MAGIC = b'\x89MCAP0\r\n'
COUNT = 100


def numbers(path: Path, **options: object) -> list[int]:
    return [message.data[0] for message in read_messages(path, **options)]


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return an MCAP file of a hundred messages in chunks of twenty or so."""
    folder = tmp_path_factory.mktemp('damage') / 'run'
    with BagWriter(folder, options=BagOptions(chunk_size_bytes=4096)) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        for number in range(COUNT):
            writer.write('/a', bytes([number]) * 200, number * 10 ** 8, 0)
    return (folder / 'run_0.mcap').read_bytes()


def test_damaged_bags_by_the_thousand() -> None:
    result = fuzz(seed=20, inputs=1500)
    assert result.wrong == ()
    assert 1000 < result.rejected < 1500
    assert result.memory_mb < 300


@pytest.mark.parametrize('percent', range(100))
def test_a_file_cut_at_any_place(whole: bytes, tmp_path: Path, percent: int) -> None:
    path = tmp_path / 'cut.mcap'
    path.write_bytes(whole[:len(whole) * percent // 100])
    with pytest.raises(BagError, match=r'cut\.mcap (was not finished.* byte \d+ of|is not an)'):
        numbers(path)
    if percent:
        problems: list[str] = []
        read = numbers(path, tolerant=True, report=problems.append)
        assert read == list(range(len(read)))
        assert len(problems) == 1
        assert recover(path, tmp_path / 'bag', report=print) == len(read)
        with Reader(tmp_path / 'bag') as reader:
            assert [data[0] for _, _, data in reader.messages()] == read


def test_bags_without_messages(tmp_path: Path) -> None:
    BagWriter(tmp_path / 'empty').close()
    assert list(read_messages(tmp_path / 'empty')) == []
    result, problems = describe(tmp_path / 'empty')
    assert (result.rows, problems, result.conditions['messages']) == ([], [], 0)
    (tmp_path / 'magic.mcap').write_bytes(MAGIC)
    assert list(read_messages(tmp_path / 'magic.mcap', tolerant=True)) == []
    with pytest.raises(BagError, match='whole records end at byte 8 of 8'):
        list(read_messages(tmp_path / 'magic.mcap'))


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack('<BQ', opcode, len(content) if length is None else length) + content


def text(value: bytes, length: int | None = None) -> bytes:
    return struct.pack('<L', len(value) if length is None else length) + value


def chunk(data: bytes, compression: bytes, size: int, length: int | None = None) -> bytes:
    head = struct.pack('<QQQL', 0, 10 ** 9, size, 0) + text(compression)
    return record(6, head + struct.pack('<Q', len(data) if length is None else length) + data)


HEADER = record(1, text(b'ros2') + text(b'test'))
CHANNEL = record(4, struct.pack('<HH', 1, 0) + text(b'/a') + text(b'cdr') + text(b''))
MESSAGE = record(5, struct.pack('<HLQQ', 1, 0, 5, 5) + b'\x07 sound')
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
ZEROS = 2 ** 30

HUGE: dict[str, Callable[[], bytes]] = {
    'chunk that says it unpacks to an exabyte': lambda: chunk(MESSAGE, b'', 2 ** 60),
    'chunk that says it holds an exabyte': lambda: chunk(MESSAGE, b'', len(MESSAGE), 2 ** 60),
    'zstd that says it is a gigabyte': lambda: chunk(
        zstandard.compress(bytes(2 ** 20)), b'zstd', ZEROS),
    'zstd that is a gigabyte': lambda: chunk(zstd_zeros(ZEROS), b'zstd', ZEROS),
    'zstd that is a gigabyte and says a kilobyte': lambda: chunk(
        zstd_zeros(ZEROS), b'zstd', 1024),
    'lz4 that is 64 megabytes and says a kilobyte': lambda: chunk(
        lz4.frame.compress(bytes(2 ** 26)), b'lz4', 1024),
    'compression nobody knows': lambda: chunk(MESSAGE, b'rar', len(MESSAGE)),
    'compression with a name of 4 GB': lambda: record(
        6, struct.pack('<QQQL', 0, 0, 10, 0) + text(b'zstd', 2 ** 32 - 1)),
    'schema with a name of 4 GB': lambda: record(3, b'\1\0' + text(b'x', 2 ** 32 - 1)),
    'channel with metadata of 4 GB': lambda: record(
        4, struct.pack('<HH', 2, 0) + text(b'/b') + text(b'cdr') + text(b'', 2 ** 32 - 1)),
    'message shorter than its head': lambda: record(5, b'\1\0'),
    'message of a channel that is not there': lambda: record(
        5, struct.pack('<HLQQ', 9, 0, 5, 5)),
    'record in a chunk of an exabyte': lambda: chunk(
        record(5, b'', 2 ** 60), b'', len(record(5, b'', 2 ** 60))),
}


def zstd_zeros(size: int) -> bytes:
    compressor = zstandard.ZstdCompressor().compressobj()
    piece = bytes(2 ** 24)
    return b''.join([compressor.compress(piece) for _ in range(size // len(piece))]
                    + [compressor.flush()])


@pytest.mark.parametrize('kind', HUGE)
def test_records_that_lie_cost_no_memory_and_no_others(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'lie.mcap'
    path.write_bytes(MAGIC + HEADER + CHANNEL + HUGE[kind]() + MESSAGE + END)
    tracemalloc.start()
    try:
        problems: list[str] = []
        assert numbers(path, tolerant=True, report=problems.append) == [7]
        assert any('lie.mcap: byte ' in problem for problem in problems)
        with pytest.raises(BagError, match=r'lie\.mcap is damaged at byte \d+: '):
            list(read_messages(path))
        examine(path)
        assert tracemalloc.get_traced_memory()[1] < 2 ** 26
    finally:
        tracemalloc.stop()


def test_a_record_longer_than_the_file_ends_it(tmp_path: Path) -> None:
    path = tmp_path / 'long.mcap'
    for length in (2 ** 40, 2 ** 63, 2 ** 64 - 1):
        path.write_bytes(MAGIC + HEADER + CHANNEL + MESSAGE + record(5, b'', length) + END)
        assert numbers(path, tolerant=True) == [7]
        at = len(MAGIC + HEADER + CHANNEL + MESSAGE)
        with pytest.raises(BagError, match=f'damaged at byte {at}: no record is {length} bytes'):
            list(read_messages(path))


def test_messages_without_a_definition_or_of_another_encoding(
        tmp_path: Path, samples: dict[str, bytes]) -> None:
    path = tmp_path / 'foreign.mcap'
    with open(path, 'wb') as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        empty = writer.register_schema(TYPE, 'ros2msg', b'')
        odd = writer.register_schema('x', 'flatbuffer', b'\xff\xfe')
        for topic, encoding, schema in (('/empty', 'cdr', empty), ('/odd', 'flatbuffer', odd),
                                        ('/json', 'json', 0)):
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 1, samples[TYPE], 1)
        writer.finish()
    messages = {message.topic: message for message in read_messages(path)}
    assert set(messages) == {'/empty', '/odd', '/json'}
    # The installed definition serves where the bag has none.
    assert decode(TYPE, messages['/empty'].data).header.frame_id == 'star_tracker_optical_frame'
    with pytest.raises(BagError, match='x is not installed'):
        decode(messages['/odd'].type_name, messages['/odd'].data)
    topics = read_topics(path)
    assert topics['/json'] == BagTopic('/json', '', 1)
    assert [topics[name].encoding for name in ('/empty', '/odd', '/json')] == [
        'cdr', 'flatbuffer', 'json']
    result, problems = describe(path)
    assert problems == [] and {row['type'] for row in result.rows} == {TYPE, 'x', 'json'}


@pytest.mark.parametrize('text, expected', [
    ('', ()), ('[]', ()), ('~', ()),
    ('- depth: 3\n  history: 2', (QosProfile('keep_all', 3),)),
    ('- history: 77\n  reliability: -1', (QosProfile('unknown', 0, 'unknown'),)),
    ('- {deadline: {sec: 2147483647, nsec: 4294967295}, lifespan: {sec: -1, nsec: 0}}',
     (QosProfile(deadline_ns=2147483647 * 10 ** 9 + 4294967295, lifespan_ns=0),)),
    ('- {durability: transient_local}', (QosProfile(durability='transient_local'),)),
    ('{}', ()), ('reliable', None), ('- reliable', None), ('- {depth: many}', None),
    ('- {reliability: RELIABLE}', None), ('- {deadline: {sec: .inf, nsec: 0}}', None),
    ('- {deadline: {sec: [], nsec: 0}}', None), ('- {deadline: 5}', None), ('*', None)])
def test_quality_of_service_of_other_versions_and_of_none(
        text: str, expected: tuple[QosProfile, ...] | None) -> None:
    if expected is not None:
        assert qos_from_yaml(text) == expected
    else:
        with pytest.raises(ValueError):
            qos_from_yaml(text)


METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: {storage}
  compression_mode: {mode}
  compression_format: zstd
  relative_file_paths: [{name}]
"""


@pytest.mark.parametrize('name', ['../outside.mcap', '{tmp}/outside.mcap', 'link.mcap',
                                  'sub/../../outside.mcap'])
def test_files_outside_of_the_folder_are_not_touched(whole: bytes, tmp_path: Path,
                                                     name: str) -> None:
    (tmp_path / 'outside.mcap').write_bytes(whole)
    bag = tmp_path / 'bag'
    (bag / 'sub').mkdir(parents=True)
    (bag / 'link.mcap').symlink_to(tmp_path / 'outside.mcap')
    name = name.format(tmp=tmp_path)
    (bag / 'metadata.yaml').write_text(METADATA.format(storage='mcap', mode='none', name=name))
    for tolerant in (False, True):
        with pytest.raises(BagError, match=f'names .*{Path(name).name}.*, outside of the folder'):
            numbers(bag, tolerant=tolerant)


@pytest.mark.parametrize('metadata, words', [
    (METADATA.format(storage='other', mode='none', name='run_0.other'),
     'is stored as other, only mcap and sqlite3 can be read; on a ROS install `ros2 bag convert`'),
    (METADATA.format(storage='mcap', mode='FILE', name='run_0.mcap').replace('zstd', 'lz4'),
     'compressed by rosbag2 as whole files with lz4, only zstd can be read'),
    (METADATA.format(storage='mcap', mode='none', name='gone.mcap'), "'gone.mcap' is not there"),
    (METADATA.format(storage='mcap', mode='none', name=''), 'names no files'),
    (METADATA.format(storage='mcap', mode='none', name='{}'), 'names no files'),
    ('', 'no rosbag2_bagfile_information'),
    ('[' * 10 ** 6, 'nested deeper than 30'),
    ('- ' * 10 ** 6, 'nested deeper than 30'),
    ('a: &a [x]\nb: *a', 'it has aliases'),
    ('a: *a', 'it has aliases'),
    ('!!int ""', 'no YAML'),
    (2 ** 24 * 'x' + 'x', 'bytes are not metadata'),
    ('when: 2001-99-99', 'no YAML'),
    ('\0', 'no YAML')], ids=lambda value: value[-40:])
def test_metadata_that_says_nothing(whole: bytes, tmp_path: Path, metadata: str,
                                    words: str) -> None:
    (tmp_path / 'run_0.mcap').write_bytes(whole)
    (tmp_path / 'metadata.yaml').write_text(metadata)
    with pytest.raises(BagError, match=words):
        numbers(tmp_path)
    if 'storage_identifier: other' in metadata or 'FILE' in metadata:
        return
    problems: list[str] = []
    assert numbers(tmp_path, tolerant=True, report=problems.append) == list(range(COUNT))
    assert len(problems) == 1 and words in problems[0]
