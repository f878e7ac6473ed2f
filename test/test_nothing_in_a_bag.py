# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that get nothing out of a bag that has messages say why."""

from pathlib import Path

from commands import invoke
from mcap.reader import make_reader
from mcap.writer import Writer
import pytest

SOURCE = Path(__file__).parents[1] / 'bags' / 'slew' / 'slew_0.mcap'
HOLDS = 'the bag holds 180 messages of /eye/a, /eye/camera_info, /eye/picture'


@pytest.fixture(scope='module')
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of a camera whose topics have other names."""
    path = tmp_path_factory.mktemp('foreign') / 'eye.mcap'
    names = {'/image_raw': '/eye/picture', '/camera_info': '/eye/camera_info', '/centroids':
             '/eye/a'}
    with open(SOURCE, 'rb') as source, open(path, 'wb') as file:
        writer, channels = Writer(file), {}
        writer.start(profile='ros2')
        for schema, channel, message in make_reader(source).iter_messages(topics=[*names]):
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(
                    names[channel.topic], channel.message_encoding, writer.register_schema(
                        schema.name, schema.encoding, schema.data))
            writer.add_message(channels[channel.topic], message.log_time, message.data,
                               message.publish_time)
        writer.finish()
    return path


@pytest.mark.parametrize('command, reason', [
    (['export', '-o', 'out'], 'the bag holds no attitude: no /attitude, /attitude_cov, '),
    (['export', '-o', 'out', '--format', 'csv'], 'no frame of a star tracker: no /image_raw, '),
    (['report', '-o', 'page.html'], 'no frame of a star tracker: no /image_raw, /centroids, '),
    (['reprocess', '-o', 'run', '--workers', '1'],
     'no star tracker in it: no */centroids, */image_raw; '),
    (['reprocess', '-o', 'run', '--workers', '1', '--source', 'image_raw'],
     'no star tracker in it: no */image_raw; '),
    (['night'], 'no images: no */image_raw; '),
    (['night', '--namespace', 'moon'], 'no images: no /moon/image_raw; ')], ids=' '.join)
def test_what_is_not_there_is_named_beside_what_is(
        foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str],
        reason: str) -> None:
    monkeypatch.chdir(tmp_path)
    done = invoke(command[0], str(foreign), *command[1:])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit), done.output
    assert reason in done.stderr and HOLDS in done.stderr, done.stderr
    assert done.stderr.count('\n') == 1


def test_a_topic_of_another_type_is_named(foreign: Path) -> None:
    """The type that a bag says, and the one that is wanted."""
    path = foreign.with_name('typed.mcap')
    with open(foreign, 'rb') as source, open(path, 'wb') as file:
        writer = Writer(file)
        writer.start(profile='ros2')
        for schema, _, message in make_reader(source).iter_messages(topics=['/eye/camera_info']):
            channel = writer.register_channel('image_raw', 'cdr', writer.register_schema(
                schema.name, schema.encoding, schema.data))
            writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    type_name = 'sensor_msgs/msg/CameraInfo'
    done = invoke('night', str(path))
    assert done.exit_code == 1
    assert f'/image_raw is {type_name}, not sensor_msgs/msg/Image' in done.stderr
    done = invoke('report', str(path), '-o', str(path.with_name('page.html')))
    assert done.exit_code == 1
    assert f'60 of 60 messages not used: type {type_name!r} is not' in done.stderr


def test_tables_without_rows_are_explained(tmp_path: Path) -> None:
    done = invoke('export', str(SOURCE), '-o', str(tmp_path))
    assert done.exit_code == 0 and done.stderr == ''
    assert 'without rows: diagnostics: no /diagnostics\n' in done.stdout
