# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags, read back with rosbags and with the reader of the mcap library."""

from collections.abc import Callable
from pathlib import Path
import subprocess
import sys

from hypothesis import given, settings, strategies as st
from limits import HANGS_S
from mcap.reader import make_reader
import pytest
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader
from rosbags.typesys.store import Typestore
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.bags.writer import BagOptions, BagWriter
import yaml

START_NS = 1_700_000_000_000_000_000
NONE, LZ4, ZSTD = (BagOptions(compression=name) for name in ('none', 'lz4', 'zstd'))

IMAGE_QOS = QosProfile(history='keep_last', depth=2)
STATE_QOS = QosProfile('keep_all', 5, 'best_effort', 'transient_local', 1_500_000_001, 10 ** 9,
                       'manual_by_topic', 2, True)

METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 250
  starting_time:
    nanoseconds_since_epoch: 1700000000000000000
  message_count: 2
  topics_with_message_count:
    - topic_metadata:
        name: /attitude
        type: geometry_msgs/msg/QuaternionStamped
        serialization_format: cdr
        offered_qos_profiles:
          - history: unknown
            depth: 0
            reliability: reliable
            durability: volatile
            deadline:
              sec: 9223372036
              nsec: 854775807
            lifespan:
              sec: 9223372036
              nsec: 854775807
            liveliness: automatic
            liveliness_lease_duration:
              sec: 9223372036
              nsec: 854775807
            avoid_ros_namespace_conventions: false
        type_description_hash: HASH
      message_count: 2
    - topic_metadata:
        name: /odd
        type: no_msgs/msg/Such
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: ""
      message_count: 0
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - run_0.mcap
  files:
    - path: run_0.mcap
      starting_time:
        nanoseconds_since_epoch: 1700000000000000000
      duration:
        nanoseconds: 250
      message_count: 2
  custom_data: ~
  ros_distro: jazzy"""


@pytest.mark.parametrize('options', [NONE, LZ4, ZSTD], ids=lambda options: options.compression)
def test_rosbags_reads_what_was_written(tmp_path: Path, store: Typestore,
                                        samples: dict[str, bytes], options: BagOptions) -> None:
    written = []
    with BagWriter(tmp_path / 'run', options=options) as writer:
        for type_name in samples:
            writer.add_topic(f'/st0/{type_name}', type_name, [IMAGE_QOS, STATE_QOS])
        for frame in range(25):
            for order, (type_name, cdr) in enumerate(samples.items()):
                log_time_ns = START_NS + 10 ** 8 * frame + order
                writer.write(f'/st0/{type_name}', cdr, log_time_ns, log_time_ns - 1000)
                written.append((f'/st0/{type_name}', log_time_ns, cdr))
    with Reader(tmp_path / 'run') as reader:
        assert reader.message_count == len(written)
        assert reader.start_time == START_NS
        assert reader.end_time == written[-1][1] + 1
        assert reader.ros_distro == 'jazzy'
        read = [(connection.topic, time_ns, bytes(cdr))
                for connection, time_ns, cdr in reader.messages()]
        assert read == written
        for connection in reader.connections:
            type_name = connection.msgtype
            assert connection.topic == f'/st0/{type_name}'
            assert connection.msgcount == 25
            assert connection.digest == store.hash_rihs01(type_name)
            assert connection.msgdef.data.startswith(
                (Path(sys.prefix) / 'share' / f'{type_name}.msg').read_text())
            image, state = connection.ext.offered_qos_profiles
            assert (image.history, image.depth) == (QosHistory.KEEP_LAST, 2)
            assert image.deadline == QosTime(9223372036, 854775807)
            assert state == type(state)(
                QosHistory.KEEP_ALL, 5, QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL,
                QosTime(1, 500_000_001), QosTime(1, 0), QosLiveliness.MANUAL_BY_TOPIC,
                QosTime(0, 2), True)
            assert store.deserialize_cdr(samples[type_name], type_name) is not None


def test_metadata_is_that_of_rosbag2(tmp_path: Path, store: Typestore,
                                     samples: dict[str, bytes]) -> None:
    type_name = 'geometry_msgs/msg/QuaternionStamped'
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/attitude', type_name, [QosProfile()])
        writer.add_topic('/odd', 'no_msgs/msg/Such')
        for time_ns in (START_NS + 250, START_NS):
            writer.write('/attitude', samples[type_name], time_ns, time_ns)
    expected = METADATA.replace('HASH', store.hash_rihs01(type_name))
    assert (tmp_path / 'run' / 'metadata.yaml').read_text() == expected
    with open(tmp_path / 'run' / 'run_0.mcap', 'rb') as file:
        reader = make_reader(file)
        inside = [record.metadata['serialized_metadata'] for record in reader.iter_metadata()]
    bare = yaml.safe_load(expected)['rosbag2_bagfile_information']
    assert yaml.safe_load(inside[-1]) == bare
    assert yaml.safe_load(inside[0])['message_count'] == 0


def test_mcap_records(tmp_path: Path, store: Typestore, samples: dict[str, bytes]) -> None:
    state, cdr = 'diagnostic_msgs/msg/DiagnosticStatus', b'\x00\x01\x00\x00anything'
    with BagWriter(tmp_path / 'run', options=ZSTD) as writer:
        writer.add_topic('/a/tracker_state', state, [STATE_QOS])
        writer.add_topic('/b/tracker_state', state)
        writer.add_topic('/odd', 'no_msgs/msg/Such')
        for frame in range(3):
            writer.write('/a/tracker_state', samples[state], START_NS + frame, START_NS - 5)
        writer.write('/odd', cdr, START_NS + 9, 0)
    with open(tmp_path / 'run' / 'run_0.mcap', 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        read = list(reader.iter_messages())
    assert header.profile == 'ros2' and header.library.startswith('startracker_ros mcap-python/')
    assert [(message.sequence, message.log_time - START_NS, message.publish_time - START_NS)
            for _, _, message in read] == [(0, 0, -5), (1, 1, -5), (2, 2, -5), (0, 9, 9)]
    assert len(summary.schemas) == 2
    assert summary.statistics.message_count == 4
    assert {index.compression for index in summary.chunk_indexes} == {'zstd'}
    assert all(index.message_index_offsets for index in summary.chunk_indexes)
    first, second, odd = summary.channels.values()
    assert first.message_encoding == 'cdr' and first.schema_id == second.schema_id
    assert first.metadata['topic_type_hash'] == store.hash_rihs01(state)
    assert yaml.safe_load(first.metadata['offered_qos_profiles']) == [STATE_QOS.as_dict()]
    assert second.metadata['offered_qos_profiles'] == '[]'
    unknown = summary.schemas[odd.schema_id]
    assert (unknown.name, unknown.encoding, unknown.data) == ('no_msgs/msg/Such', '', b'')


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.sampled_from(['/a', '/b', '/c']), st.integers(0, 2 ** 63 - 1),
                       st.integers(0, 2 ** 63 - 1), st.binary(max_size=6000)), max_size=30),
    st.sampled_from(['none', 'lz4', 'zstd']))
def test_any_messages_in_any_order_of_time(tmp_path_factory: pytest.TempPathFactory,
                                           messages: list[tuple], compression: str) -> None:
    bag = tmp_path_factory.mktemp('any') / 'run'
    options = BagOptions(compression=compression, chunk_size_bytes=4096)
    with BagWriter(bag, options=options) as writer:
        for topic in ('/a', '/b', '/c'):
            writer.add_topic(topic, 'std_msgs/msg/Header')
        for topic, log_time_ns, publish_time_ns, cdr in messages:
            writer.write(topic, cdr, log_time_ns, publish_time_ns)
    expected = [(topic, cdr, log_time_ns, publish_time_ns or log_time_ns)
                for topic, log_time_ns, publish_time_ns, cdr in messages]

    def read(tolerant: bool) -> list[tuple]:
        return [(message.topic, message.data, message.log_time_ns, message.publish_time_ns)
                for message in read_messages(bag, tolerant=tolerant)]
    assert read(tolerant=True) == read(tolerant=False) == sorted(
        expected, key=lambda message: message[2])
    with Reader(bag) as reader:
        assert reader.message_count == len(messages)
        if messages:
            assert reader.start_time == min(message[1] for message in messages)
            assert reader.end_time == max(message[1] for message in messages) + 1


def test_wrong_use(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'run')
    writer.add_topic('/a', 'std_msgs/msg/Header')
    with pytest.raises(BagError, match='run_0.mcap: topic /a was added before'):
        writer.add_topic('/a', 'std_msgs/msg/Header')
    with pytest.raises(BagError, match='run_0.mcap: topic /b was not added'):
        writer.write('/b', b'', 1, 1)
    for times_ns in ((-1, 1), (1, 2 ** 64)):
        with pytest.raises(ValueError, match='/a: times .* are not UNIX times'):
            writer.write('/a', b'', *times_ns)
    with pytest.raises(ValueError, match="reliability = 'RELIABLE' must be one of system_default"):
        QosProfile(reliability='RELIABLE')
    writer.write('/a', b'whole', 1, 1)
    writer.close()
    writer.close()
    for late in (lambda: writer.write('/a', b'', 1, 1), writer.flush,
                 lambda: writer.add_topic('/b', 'std_msgs/msg/Header')):
        with pytest.raises(BagError, match='run_0.mcap is closed'):
            late()
    assert [message.data for message in read_messages(tmp_path / 'run')] == [b'whole']


def put_in_folder(tmp_path: Path) -> tuple[Path, str]:
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'notes.txt').write_text('keep me')
    return tmp_path / 'run', 'the folder is not empty'


def put_in_place(tmp_path: Path) -> tuple[Path, str]:
    (tmp_path / 'run').write_text('keep me')
    return tmp_path / 'run', 'File exists'


def put_above(tmp_path: Path) -> tuple[Path, str]:
    (tmp_path / 'file').write_text('keep me')
    return tmp_path / 'file' / 'run', 'Not a directory'


def in_proc(tmp_path: Path) -> tuple[Path, str]:
    return Path('/proc/run'), 'No such file or directory'


@pytest.mark.parametrize('obstacle', [put_in_folder, put_in_place, put_above, in_proc])
def test_a_folder_that_cannot_be_used(
        tmp_path: Path, obstacle: Callable[[Path], tuple[Path, str]]) -> None:
    folder, reason = obstacle(tmp_path)
    with pytest.raises(BagError) as caught:
        BagWriter(folder)
    assert str(caught.value) == f'cannot record to {folder}: {reason}'
    assert all(file.read_text() == 'keep me' for file in tmp_path.rglob('*') if file.is_file())


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    BagWriter(tmp_path).close()
    assert (tmp_path / f'{tmp_path.name}_0.mcap').is_file()
    with Reader(tmp_path) as reader:
        assert reader.message_count == 0


KILLED = """\
from pathlib import Path
import random
import sys
from startracker_ros.io.bags.writer import BagOptions, BagWriter

writer = BagWriter(Path(sys.argv[1]), options=BagOptions(compression=sys.argv[2]))
for topic in ('/image_raw', '/attitude'):
    writer.add_topic(topic, 'std_msgs/msg/Header')
noise = random.Random(3)
for frame in range(10 ** 6):
    time_ns = frame * 10 ** 8
    writer.write('/image_raw', noise.randbytes(40_000), time_ns, time_ns)
    writer.write('/attitude', frame.to_bytes(8), time_ns + 1, time_ns)
    print(frame, flush=True)
"""


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_a_killed_recorder_loses_one_second_at_most(tmp_path: Path, compression: str) -> None:
    bag = tmp_path / 'run'
    with subprocess.Popen([sys.executable, '-c', KILLED, str(bag), compression],
                          stdout=subprocess.PIPE, text=True) as recorder:
        for line in recorder.stdout:
            if int(line) == 137:
                recorder.kill()
                break
    with pytest.raises(BagError, match='run_0.mcap was not finished'):
        list(read_messages(bag))
    frames = [int.from_bytes(message.data) for message in read_messages(bag, tolerant=True)
              if message.topic == '/attitude']
    assert frames == list(range(len(frames)))
    assert frames[-1] >= 137 - 10
    images = list(read_messages(bag, topics=('/image_raw',), tolerant=True))
    assert len(frames) <= len(images) <= len(frames) + 1


def test_flush_writes_what_is_there(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'run')
    writer.add_topic('/a', 'std_msgs/msg/Header')
    writer.write('/a', b'now', 5, 5)
    assert list(read_messages(tmp_path / 'run', tolerant=True)) == []
    writer.flush()
    assert [message.data for message in read_messages(tmp_path / 'run', tolerant=True)] == [b'now']
    writer.close()


FULL = """\
from pathlib import Path
import random
import resource
import sys
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.writer import BagWriter

resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
noise = random.Random(3)
with BagWriter(Path(sys.argv[1])) as writer:
    writer.add_topic('/image_raw', 'std_msgs/msg/Header')
    for frame in range(1000):
        try:
            writer.write('/image_raw', noise.randbytes(40_000), frame * 10 ** 8, 0)
        except BagError as error:
            print(frame, error)
            break
    try:
        writer.write('/image_raw', b'', 0, 0)
    except BagError as error:
        print(error)
"""


def test_a_full_disk_keeps_what_came_before(tmp_path: Path) -> None:
    bag = tmp_path / 'run'
    done = subprocess.run([sys.executable, '-c', FULL, str(bag)], capture_output=True, text=True,
                          timeout=HANGS_S)
    assert (done.returncode, done.stderr) == (0, '')
    first, second = done.stdout.splitlines()
    frame, text = first.split(' ', 1)
    assert text == (f'{bag}/run_0.mcap: File too large: the recording ends here, what was written '
                    'before can be read')
    assert second == f'{bag}/run_0.mcap is closed'
    messages = list(read_messages(bag, tolerant=True))
    assert len(messages) >= int(frame) - 10 > 0
    assert [message.log_time_ns for message in messages] == [
        number * 10 ** 8 for number in range(len(messages))]
    assert {len(message.data) for message in messages} == {40_000}


@pytest.mark.parametrize('options, files', [
    (BagOptions(max_file_size_mb=0.2, compression='none', chunk_size_bytes=4096), 5),
    (BagOptions(max_file_duration_s=2.0), 5)], ids=['size', 'duration'])
def test_a_bag_is_split(tmp_path: Path, options: BagOptions, files: int) -> None:
    with BagWriter(tmp_path / 'run', options=options) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header', [STATE_QOS])
        for frame in range(100):
            if frame == 50:
                writer.add_topic('/late', 'std_msgs/msg/Header')
            for topic in ('/a', '/late') if frame >= 50 else ('/a',):
                time_ns = START_NS + frame * 10 ** 8
                writer.write(topic, frame.to_bytes(4) + bytes(6000), time_ns, time_ns)
    paths = sorted((tmp_path / 'run').glob('*.mcap'))
    assert [path.name for path in paths] == [f'run_{number}.mcap' for number in range(files)]
    with Reader(tmp_path / 'run') as reader:
        assert reader.message_count == 150
        assert (reader.start_time, reader.end_time) == (START_NS, START_NS + 99 * 10 ** 8 + 1)
        frames = [int.from_bytes(data[:4]) for connection, _, data in reader.messages()
                  if connection.topic == '/a']
        assert {c.topic: c.msgcount for c in reader.connections} == {'/a': 100, '/late': 50}
    assert frames == list(range(100))
    information = yaml.safe_load(
        (tmp_path / 'run' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    for path, entry in zip(paths, information['files'], strict=True):
        # Each file can be opened by itself.
        with open(path, 'rb') as file:
            reader = make_reader(file, validate_crcs=True)
            times_ns = [message.log_time for _, _, message in reader.iter_messages()]
        assert entry == {
            'path': path.name, 'message_count': len(times_ns),
            'starting_time': {'nanoseconds_since_epoch': min(times_ns)},
            'duration': {'nanoseconds': max(times_ns) - min(times_ns)}}
        if options.max_file_size_mb:
            assert path.stat().st_size < 0.22e6
        else:
            assert max(times_ns) - min(times_ns) < 2 * 10 ** 9


def test_large_messages_have_chunks_of_their_own(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run', options=BagOptions(chunk_size_bytes=4096)) as writer:
        for topic in ('/image_raw', '/attitude'):
            writer.add_topic(topic, 'std_msgs/msg/Header')
        for frame in range(5):
            writer.write('/attitude', b'small', START_NS + 2 * frame, 0)
            writer.write('/image_raw', bytes(10_000), START_NS + 2 * frame + 1, 0)
    with open(tmp_path / 'run' / 'run_0.mcap', 'rb') as file:
        indexes = make_reader(file).get_summary().chunk_indexes
    assert len(indexes) == 10
    assert all(len(index.message_index_offsets) == 1 for index in indexes)
