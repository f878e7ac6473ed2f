# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reading bags whole, cut off and damaged; decoding, against rosbags."""

from pathlib import Path
import shutil
from typing import Any

from hypothesis import given, settings, strategies as st
from mcap.records import Schema
from mcap.writer import IndexType, Writer
import numpy as np
import pytest
from rosbags.rosbag2 import (
    CompressionFormat, CompressionMode, StoragePlugin, Writer as RosbagsWriter)
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore
from startracker_ros.io.bags.errors import BagError, UnfinishedBagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.reader import (
    BagMessage, BagTopic, decode, read_messages, read_rates_hz, read_topics)
from startracker_ros.io.bags.writer import BagOptions, BagWriter

TYPE = 'geometry_msgs/msg/QuaternionStamped'
COUNT = 60


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory, samples: dict[str, bytes]) -> Path:
    """Return a bag of two topics in several chunks, 10 Hz from time 0 on."""
    folder = tmp_path_factory.mktemp('reader') / 'run'
    with BagWriter(folder, options=BagOptions(compression='lz4', chunk_size_bytes=4096)) as writer:
        writer.add_topic('/attitude', TYPE)
        writer.add_topic('/silent', 'std_msgs/msg/Header')
        writer.add_topic('/count', 'std_msgs/msg/Header')
        for frame in range(COUNT):
            writer.write('/attitude', samples[TYPE], frame * 10 ** 8, frame * 10 ** 8)
            writer.write('/count', bytes([frame]), frame * 10 ** 8 + 1, 7)
    return folder


def counts(bag: Path, **options: object) -> list[int]:
    return [message.data[0] for message in read_messages(bag, topics=('/count',), **options)]


@pytest.mark.parametrize('tolerant', [False, True])
def test_topics_and_times_can_be_chosen(bag: Path, tolerant: bool) -> None:
    everything = list(read_messages(bag, tolerant=tolerant))
    assert len(everything) == 2 * COUNT
    assert list(read_messages(bag / 'run_0.mcap', tolerant=tolerant)) == everything
    late = list(read_messages(bag, topics=('/count',), start_ns=10 ** 9 + 1, tolerant=tolerant))
    assert [message.data[0] for message in late] == list(range(10, COUNT))
    assert {(message.topic, message.type_name, message.publish_time_ns) for message in late} == {
        ('/count', 'std_msgs/msg/Header', 7)}
    assert list(read_messages(bag, topics=('/other',), tolerant=tolerant)) == []


def test_topics_are_counted(bag: Path) -> None:
    heard = {'/attitude': BagTopic('/attitude', TYPE, COUNT),
             '/count': BagTopic('/count', 'std_msgs/msg/Header', COUNT)}
    silent = {'/silent': BagTopic('/silent', 'std_msgs/msg/Header', 0)}
    for tolerant in (False, True):
        assert read_topics(bag, tolerant=tolerant) == heard | silent


def test_a_bag_of_several_files(bag: Path, tmp_path: Path) -> None:
    for number in (0, 2, 10):
        shutil.copy(bag / 'run_0.mcap', tmp_path / f'split_{number}.mcap')
    assert counts(tmp_path) == 3 * list(range(COUNT))
    assert read_topics(tmp_path)['/count'].message_count == 3 * COUNT


@pytest.mark.parametrize('tolerant', [False, True])
def test_bags_of_others(tmp_path: Path, store: Typestore, samples: dict[str, bytes],
                        tolerant: bool) -> None:
    with RosbagsWriter(tmp_path / 'theirs', version=9, storage_plugin=StoragePlugin.MCAP) as other:
        connection = other.add_connection('/attitude', TYPE, typestore=store)
        other.write(connection, 42, samples[TYPE])
    message, = read_messages(tmp_path / 'theirs', tolerant=tolerant)
    assert (message.topic, message.type_name, message.log_time_ns) == ('/attitude', TYPE, 42)
    assert message.data == samples[TYPE]
    # Neither chunks, nor an index, nor schemas: as simple as a file may be.
    with open(tmp_path / 'plain.mcap', 'wb') as file:
        writer = Writer(file, use_chunking=False, use_statistics=False, repeat_channels=False,
                        repeat_schemas=False, use_summary_offsets=False)
        writer.start()
        channel = writer.register_channel('/plain', 'json', 0)
        for time_ns in (2, 1):
            writer.add_message(channel, time_ns, b'{}', time_ns)
        writer.finish()
    times_ns = [message.log_time_ns
                for message in read_messages(tmp_path / 'plain.mcap', tolerant=tolerant)]
    assert times_ns == [1, 2]
    assert read_topics(tmp_path / 'plain.mcap', tolerant=tolerant) == {
        '/plain': BagTopic('/plain', '', 2)}


@pytest.mark.parametrize('options', [
    {'index_types': IndexType.CHUNK}, {'index_types': IndexType.MESSAGE},
    {'index_types': IndexType.NONE}, {'repeat_schemas': False}, {'repeat_channels': False},
    {'use_statistics': False, 'repeat_schemas': False}, {'use_chunking': False},
    {'use_summary_offsets': False, 'index_types': IndexType.CHUNK, 'use_statistics': False}],
    ids=str)
@pytest.mark.parametrize('slash', ['/', ''])
def test_indexes_slashes_and_summaries_that_recorders_leave_out(
        bag: Path, tmp_path: Path, options: dict[str, Any], slash: str) -> None:
    path = tmp_path / 'theirs.mcap'
    with open(path, 'wb') as file:
        writer = Writer(file, chunk_size=4096, **options)
        writer.start()
        channels = {}
        for message in read_messages(bag):
            if message.topic not in channels:
                # The type of one of them is defined only where its first message is.
                writer.flush()
                schema = writer.register_schema(message.type_name, 'ros2msg', b'')
                channels[message.topic] = writer.register_channel(
                    slash + message.topic.removeprefix('/'), 'cdr', schema)
            writer.add_message(channels[message.topic], message.log_time_ns, message.data,
                               message.publish_time_ns)
        writer.finish()
    result, problems = describe(path)
    assert problems == []
    assert [(row['topic'], row['type'], row['messages'], row['rate_hz'])
            for row in result.records] == [('/attitude', TYPE, COUNT, 10.0),
                                           ('/count', 'std_msgs/msg/Header', COUNT, 10.0)]
    for topics in ((), ('/count',), ('/attitude',)):
        ours, theirs = ([message[:-1] for message in read_messages(where, topics=topics)]
                        for where in (bag, path))
        assert theirs == ours


def test_the_rate_is_that_of_the_messages_and_not_of_the_span(tmp_path: Path) -> None:
    frames = [0.1 * number for number in range(20)]
    times_s = {
        # A camera that begins late and pauses; a gyro of 100 Hz that sends two at once; a map.
        '/camera': [5.0 + time_s for time_s in frames] + [12.0 + time_s for time_s in frames],
        '/gyro': [0.02 * (number // 2) + 1e-5 * (number % 2) for number in range(1000)],
        '/map': [3.0], '/end': [0.0, 20.0], '/same': [7.0, 7.0, 7.0]}
    with BagWriter(tmp_path / 'run') as writer:
        for topic in times_s:
            writer.add_topic(topic, 'std_msgs/msg/Header')
        for time_s, topic in sorted((time_s, topic) for topic, times in times_s.items()
                                    for time_s in times):
            writer.write(topic, b'', round(time_s * 1e9), 0)
    assert read_rates_hz(tmp_path / 'run') == {
        '/camera': pytest.approx(10.0), '/gyro': pytest.approx(100.0), '/end': 0.05}


def test_what_is_not_a_bag(tmp_path: Path) -> None:
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.mcap').write_text('rosbag2_bagfile_information:')
    (tmp_path / 'nothing.mcap').touch()
    for name, reason in (('missing', 'cannot read .*missing: No such file'),
                         ('empty', 'empty holds no .mcap and no .db3 file'),
                         ('text.mcap', "text.mcap is not an MCAP file: .* b'rosbag2_'"),
                         ('nothing.mcap', "nothing.mcap is not an MCAP file: .* b''")):
        for tolerant in (False, True):
            with pytest.raises(BagError, match=reason):
                list(read_messages(tmp_path / name, tolerant=tolerant))
            with pytest.raises(BagError, match=reason):
                read_topics(tmp_path / name, tolerant=tolerant)


@settings(max_examples=60)
@given(st.floats(0, 1, exclude_max=True))
def test_a_cut_file_gives_its_beginning(bag: Path, tmp_path_factory: pytest.TempPathFactory,
                                        share: float) -> None:
    whole = (bag / 'run_0.mcap').read_bytes()
    path = tmp_path_factory.mktemp('cut') / 'cut.mcap'
    size = max(8, int(share * len(whole)))
    path.write_bytes(whole[:size])
    with pytest.raises(UnfinishedBagError, match=f'cut.mcap was not finished.* of {size}'):
        list(read_messages(path))
    with pytest.raises(UnfinishedBagError):
        read_topics(path)
    read = counts(path, tolerant=True)
    assert read == list(range(len(read)))
    topics = read_topics(path, tolerant=True)
    assert len(read) == (topics['/count'].message_count if '/count' in topics else 0)


def test_the_offset_of_the_cut_is_named(bag: Path, tmp_path: Path) -> None:
    whole = (bag / 'run_0.mcap').read_bytes()
    header_end = 8 + 9 + int.from_bytes(whole[9:17], 'little')
    (tmp_path / 'cut.mcap').write_bytes(whole[:header_end + 20])
    with pytest.raises(UnfinishedBagError, match=f'whole records end at byte {header_end} of '):
        list(read_messages(tmp_path / 'cut.mcap'))


def test_a_damaged_chunk_costs_its_own_messages(bag: Path, tmp_path: Path) -> None:
    data = bytearray((bag / 'run_0.mcap').read_bytes())
    data[len(data) // 4] ^= 0xff
    (tmp_path / 'bad.mcap').write_bytes(data)
    with pytest.raises(BagError, match=r'bad.mcap is damaged at byte \d+: '):
        list(read_messages(tmp_path / 'bad.mcap'))
    read = counts(tmp_path / 'bad.mcap', tolerant=True)
    assert read == sorted(read) and read[-1] == COUNT - 1 and COUNT / 2 < len(read) < COUNT


@settings(max_examples=150)
@given(st.data())
def test_damage_is_never_more_than_a_bag_error(
        bag: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    content = bytearray((bag / 'run_0.mcap').read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp('bad') / 'bad.mcap'
    path.write_bytes(content)
    for read in (lambda: list(read_messages(path)), lambda: read_topics(path)):
        try:
            read()
        except BagError as error:
            assert 'bad.mcap' in str(error)
    list(read_messages(path, tolerant=True))
    read_topics(path, tolerant=True)


def assert_same(store: Typestore, ours: object, theirs: object) -> None:
    """Compare a decoded message with one of rosbags, field by field."""
    if hasattr(theirs, '__msgtype__'):
        _, fields = store.fielddefs[theirs.__msgtype__]
        for name, _ in fields:
            assert_same(store, getattr(ours, name), getattr(theirs, name))
    elif isinstance(theirs, list):
        assert len(ours) == len(theirs)
        for our, their in zip(ours, theirs):
            assert_same(store, our, their)
    elif isinstance(theirs, np.ndarray):
        np.testing.assert_array_equal(
            np.frombuffer(ours, theirs.dtype) if isinstance(ours, bytes) else ours, theirs)
    else:
        assert ours == theirs


def test_decoded_fields_are_those_of_rosbags(store: Typestore, samples: dict[str, bytes]) -> None:
    for type_name, cdr in samples.items():
        assert_same(store, decode(type_name, cdr), store.deserialize_cdr(cdr, type_name))


def test_a_type_that_is_not_installed_is_read_by_the_definition_in_the_bag() -> None:
    def definition(text: bytes, encoding: str = 'ros2msg') -> Schema:
        return Schema(id=1, name='no_msgs/msg/Such', encoding=encoding, data=text)

    def message(defined: Schema) -> Any:
        return BagMessage('/such', 'no_msgs/msg/Such', b'\x00\x01\x00\x00\x07\x00\x00\x00', 0, 0,
                          defined).decoded()
    assert message(definition(b'int32 x')).x == 7
    for text in (b'int32', b'no_msgs/Other x', b'no_msgs/Such x', b'\xff\xfe', b'int32[ x'):
        with pytest.raises(BagError, match='no_msgs/msg/Such|8 bytes'):
            message(definition(text))
    with pytest.raises(BagError, match="a definition as 'ros2idl' cannot be read"):
        message(definition(b'struct Such {};', 'ros2idl'))


def test_what_cannot_be_decoded(samples: dict[str, bytes]) -> None:
    with pytest.raises(BagError, match='no_msgs/msg/Such is not installed'):
        decode('no_msgs/msg/Such', b'\x00\x01\x00\x00')
    for size in range(len(samples[TYPE])):
        with pytest.raises(BagError, match=f'{size} bytes are not geometry_msgs'):
            decode(TYPE, samples[TYPE][:size])


def test_messages_compressed_one_by_one_are_named(tmp_path):
    bag = tmp_path / 'bag'
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = RosbagsWriter(bag, version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection('/text', 'std_msgs/msg/String', typestore=store)
        text = store.types['std_msgs/msg/String']('a' * 100)
        writer.write(topic, 1, store.serialize_cdr(text, 'std_msgs/msg/String'))
    result, problems = describe(bag)
    assert result.conditions['compression'] == 'zstd, each message' and not problems
