# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags made whole again, and what is reported of them."""

import json
from pathlib import Path

from click.testing import Result
from commands import invoke
from mcap.reader import make_reader
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer as RosbagsWriter
from rosbags.typesys.store import Typestore
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import read_topics
from startracker_ros.io.bags.recovery import recover
from startracker_ros.io.bags.schemas import MessageSchema
from startracker_ros.io.bags.writer import BagOptions, BagWriter

TYPE = 'geometry_msgs/msg/QuaternionStamped'
QOS = QosProfile('keep_last', 5, 'best_effort', 'transient_local')
START_NS = 1_700_000_000_000_000_000
OWN = MessageSchema('ros2msg', 'int32 count\n', 'RIHS01_' + 64 * '5')


@pytest.fixture(scope='module')
def cut(tmp_path_factory: pytest.TempPathFactory, samples: dict[str, bytes]) -> Path:
    """Return a bag of 300 messages that ends in the middle of a chunk, with no metadata.yaml."""
    folder = tmp_path_factory.mktemp('recovery') / 'run'
    with BagWriter(folder, options=BagOptions(chunk_size_bytes=4096)) as writer:
        writer.add_topic('/attitude', TYPE, [QOS])
        writer.add_topic('/own', 'own_msgs/msg/Count', schema=OWN)
        for frame in range(150):
            time_ns = START_NS + frame * 10 ** 8
            writer.write('/attitude', samples[TYPE], time_ns, time_ns - 5)
            writer.write('/own', frame.to_bytes(4), time_ns + 1, 0)
    (folder / 'metadata.yaml').unlink()
    path = folder / 'run_0.mcap'
    path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])
    return folder


def test_a_cut_bag_becomes_a_whole_one(cut: Path, tmp_path: Path, samples: dict[str, bytes],
                                       store: Typestore) -> None:
    problems: list[str] = []
    count = recover(cut, tmp_path / 'whole', report=problems.append)
    problem, = problems
    assert 'run_0.mcap was not finished' in problem
    assert 50 < count < 300
    with Reader(tmp_path / 'whole') as reader:
        assert reader.message_count == count
        messages = [(connection.topic, time_ns, bytes(data))
                    for connection, time_ns, data in reader.messages()]
        digests = {connection.topic: connection.digest for connection in reader.connections}
        assert {c.ext.offered_qos_profiles[0].depth for c in reader.connections
                if c.topic == '/attitude'} == {5}
    expected = []
    for frame in range(150):
        time_ns = START_NS + frame * 10 ** 8
        expected += [('/attitude', time_ns, samples[TYPE]),
                     ('/own', time_ns + 1, frame.to_bytes(4))]
    assert messages == expected[:count]
    assert digests == {'/attitude': store.hash_rihs01(TYPE), '/own': OWN.type_hash}
    with open(tmp_path / 'whole' / 'whole_0.mcap', 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == count
        own = next(schema for schema in reader.get_summary().schemas.values()
                   if schema.name == 'own_msgs/msg/Count')
    assert own.data.decode() == OWN.text
    assert read_topics(tmp_path / 'whole')['/attitude'].qos == (QOS,)


def test_nothing_is_recovered_into_a_folder_in_use(cut: Path, tmp_path: Path) -> None:
    (tmp_path / 'notes.txt').write_text('keep me')
    with pytest.raises(BagError, match='the folder is not empty'):
        recover(cut, tmp_path, report=print)


def startracker(*arguments: object) -> Result:
    done = invoke(*map(str, arguments))
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    return done


def test_the_command_recovers_and_lists(cut: Path, tmp_path: Path) -> None:
    before = startracker('info', cut, '--json')
    assert before.exit_code == 1 and 'was not finished' in before.stderr
    reported = json.loads(before.stdout)
    assert reported['conditions']['whole'] is False
    done = startracker('info', cut, '--recover', tmp_path / 'whole', '--json')
    assert done.exit_code == 0 and 'was not finished' in done.stderr
    document = json.loads(done.stdout)
    assert document['conditions']['whole'] is True
    assert document['rows'] == reported['rows']
    with Reader(tmp_path / 'whole') as reader:
        assert document['conditions']['messages'] == reader.message_count
        assert {row['topic']: row['messages'] for row in document['rows']} == {
            connection.topic: connection.msgcount for connection in reader.connections}
    refused = startracker('info', tmp_path / 'missing')
    assert refused.exit_code == 1
    assert 'missing: No such file' in refused.stderr


def test_a_bag_of_rosbags_is_described(tmp_path: Path, store: Typestore,
                                       samples: dict[str, bytes]) -> None:
    with RosbagsWriter(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as other:
        connection = other.add_connection('/attitude', TYPE, typestore=store)
        for frame in range(11):
            other.write(connection, START_NS + frame * 10 ** 8, samples[TYPE])
    result, problems = describe(tmp_path / 'run')
    assert problems == []
    row, = result.rows
    assert row == {'topic': '/attitude', 'type': TYPE, 'messages': 11, 'rate_hz': 10.0, 'qos': ''}
    assert result.conditions['start'] == '2023-11-14T22:13:20.000000000 UTC'
    assert result.conditions['duration_s'] == pytest.approx(1.0)
