# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""AEM against a file made by hand and an independent reader, CSV and Parquet against the bag."""

from collections.abc import Sequence
import csv
import json
from pathlib import Path
import subprocess
import sys
from typing import Any

from ccsds_ndm import Aem
from click.testing import Result
from commands import invoke
from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pyarrow.parquet
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from run_bag import (
    error_arcsec, FRAMES, HOSTILE, protection_rad, START_NS, STEP_NS, UNSOLVED, write_run)
from sensor_msgs.msg import Imu
from startracker_ros.io.export.aem import aem_text, AemError, AemLabels
from startracker_ros.io.export.files import export_bag
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import lock_segments
from startracker_ros.ros.messages.attitude import attitude_to_imu, quaternion_to_message
from startracker_ros.ros.messages.header import make_header

SOLVED = [frame for frame in range(FRAMES) if frame not in UNSOLVED]
# 2026-12-31T23:59:59.800000001
GOLDEN_NS = 1_798_761_599_800_000_001
GOLDEN = {0: np.array([1, 2, 3, 4]) / np.sqrt(30), 1: [-0.5, -0.5, -0.5, -0.5],
          2: [0.8, 0, 0.6, 0], 3: None, 4: [0.6, 0, 0, -0.8], 5: [0, -0.6, 0, 0.8]}
LABELS = AemLabels('EXAMPLE AGENCY', 'EXAMPLESAT 1', '2026-001A')


def write_messages(folder: Path, rows: Sequence[tuple[str, int, Any]]) -> Path:
    """Write a bag of topic, time and message."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, time_ns, message in rows:
            kind = type(message).__module__.split('.')[0] + '/msg/' + type(message).__name__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time_ns, serialize_message(message))
    return folder


def test_the_golden_file(tmp_path: Path) -> None:
    rows = []
    for frame, quaternion in GOLDEN.items():
        stamp_ns = GOLDEN_NS + frame * STEP_NS
        header = make_header(stamp_ns, 'icrf')
        if quaternion is None:
            rows.append(('/attitude_imu', stamp_ns, deserialize_message(
                attitude_to_imu(None, header), Imu)))
        else:
            # The same attitude twice is one epoch.
            rows += 2 * [('/attitude', stamp_ns + 7, deserialize_message(
                quaternion_to_message(quaternion, header), QuaternionStamped))]
    recording = load_recording(write_messages(tmp_path / 'golden', rows))
    expected = Path(__file__).with_name('golden.aem').read_text()
    assert aem_text(recording, LABELS, 1_790_000_000_500_000_000) == expected


def matrix_of_the_standard(q1: float, q2: float, q3: float, qc: float) -> np.ndarray:
    """Return the matrix from A to B of a quaternion, as CCSDS 504.0-B-2 has it."""
    return np.array([
        [q1 ** 2 - q2 ** 2 - q3 ** 2 + qc ** 2, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
        [2 * (q1 * q2 - q3 * qc), -q1 ** 2 + q2 ** 2 - q3 ** 2 + qc ** 2,
         2 * (q2 * q3 + q1 * qc)],
        [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc),
         -q1 ** 2 - q2 ** 2 + q3 ** 2 + qc ** 2]])


def test_an_independent_reader_takes_the_message(run: Path, tmp_path: Path) -> None:
    export_bag(run, tmp_path, ('aem',), LABELS)
    message = Aem.from_file(str(tmp_path / 'attitude.aem'))
    message.validate()
    assert message.version == '2.0'
    assert [segment.metadata.ref_frame_a for segment in message.segments] == ['ICRF', 'ICRF']
    assert message.segments[1].metadata.ref_frame_b == 'INSTRUMENT'
    assert message.segments[0].metadata.object_id == '2026-001A'
    epochs = sum((segment.data.attitude_states_epochs for segment in message.segments), [])
    stamps = np.array(epochs, 'datetime64[ns]').astype(np.int64)
    np.testing.assert_array_equal(stamps, [START_NS + frame * STEP_NS for frame in SOLVED])
    assert [len(segment.data.attitude_states_epochs) for segment in message.segments] == [28, 27]
    for segment in message.segments:
        assert segment.metadata.start_time == segment.data.attitude_states_epochs[0]
        assert segment.metadata.stop_time == segment.data.attitude_states_epochs[-1]
        quaternion = segment.data.attitude_states_numpy
        assert np.all(np.sum(quaternion[1:] * quaternion[:-1], axis=1) > 0.99)
        np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1, atol=2e-12)
    # The boresight and image up of the last frame, from B to A, by the matrix of the standard.
    recording = load_recording(run)
    matrix = matrix_of_the_standard(*message.segments[-1].data.attitude_states_numpy[-1])
    table = read_csv(export_csv(run, tmp_path) / 'attitude.csv')
    ra, dec = np.radians([float(table[-1]['ra_deg']), float(table[-1]['dec_deg'])])
    np.testing.assert_allclose(matrix.T @ [0, 0, 1], [
        np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], atol=1e-11)
    np.testing.assert_allclose(matrix.T @ [0, -1, 0], image_up(table[-1]), atol=1e-11)
    assert recording.problems == ()


def image_up(row: dict[str, str]) -> np.ndarray:
    """Return image up in ICRF: roll is its angle from north through east."""
    ra, dec, roll = np.radians([float(row[f'{name}_deg']) for name in ('ra', 'dec', 'roll')])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0])
    return np.cos(roll) * north + np.sin(roll) * east


@pytest.mark.parametrize('left_out', [(), ('attitude_imu',), ('attitude_imu', 'tracker_state')])
def test_a_loss_of_lock_begins_a_segment_whatever_tells_of_it(
        tmp_path: Path, left_out: tuple[str, ...]) -> None:
    recording = load_recording(write_run(tmp_path / 'run', leave_out=left_out))
    np.testing.assert_array_equal(lock_segments(recording), [0] * 28 + [1] * 27)


def test_lost_messages_are_not_a_loss_of_lock(tmp_path: Path) -> None:
    rows = []
    for frame in (0, 1, 2, 5, 6, 7, 12, 13):
        header = make_header(START_NS + frame * STEP_NS, 'icrf')
        rows.append(('/attitude', START_NS + frame * STEP_NS, deserialize_message(
            quaternion_to_message(np.array([0.0, 0.0, 0.0, 1.0]), header), QuaternionStamped)))
    recording = load_recording(write_messages(tmp_path / 'gaps', rows))
    np.testing.assert_array_equal(lock_segments(recording), [0] * 6 + [1] * 2)


def export_csv(run: Path, folder: Path) -> Path:
    export_bag(run, folder, ('csv',), LABELS)
    return folder


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline='', encoding='utf-8') as file:
        return list(csv.DictReader(file))


def test_csv_holds_the_figures_of_the_bag(run: Path, tmp_path: Path) -> None:
    export_csv(run, tmp_path)
    recording = load_recording(run)
    rows = read_csv(tmp_path / 'attitude.csv')
    assert rows[0]['utc'] == '2026-09-21T14:13:20.450000000'
    np.testing.assert_array_equal([int(row['stamp_ns']) for row in rows], recording.attitude_ns)
    np.testing.assert_array_equal(
        [[float(row[f'q_{axis}']) for axis in 'xyzw'] for row in rows], recording.quaternion)
    np.testing.assert_allclose(
        [[float(row[f'error_{axis}_arcsec']) for axis in 'xyz'] for row in rows],
        [error_arcsec(frame) for frame in SOLVED], atol=1e-6)
    np.testing.assert_array_equal([float(row['cov_xy_rad2']) for row in rows],
                                  recording.covariance_sensor[:, 0, 1])
    np.testing.assert_array_equal(
        [[float(row[f'protection_{axis}_rad']) for axis in 'xyz'] for row in rows],
        [protection_rad(frame) for frame in SOLVED])
    tracks = read_csv(tmp_path / 'tracks.csv')
    cloud = recording.tracks.rows
    for name in cloud.dtype.names:
        ours = np.array([float(row[name] or 'nan') for row in tracks]).astype(cloud[name].dtype)
        np.testing.assert_array_equal(ours, cloud[name])
    diagnostics = read_csv(tmp_path / 'diagnostics.csv')
    assert len(diagnostics) == 12
    assert diagnostics[0]['value'] == HOSTILE and diagnostics[0]['level'] == '1'
    assert diagnostics[1]['key'] == 'frames' and diagnostics[3]['value'] == '10'


def test_parquet_holds_the_same_as_csv(run: Path, tmp_path: Path) -> None:
    export_bag(run, tmp_path, ('csv', 'parquet'), LABELS)
    for name in ('attitude', 'tracks', 'diagnostics'):
        rows = read_csv(tmp_path / f'{name}.csv')
        table = pyarrow.parquet.read_table(tmp_path / f'{name}.parquet')
        assert table.column_names == list(rows[0])
        assert str(table.schema.field('utc').type) == 'timestamp[ns, tz=UTC]'
        assert table.num_rows == len(rows)
        for column in table.column_names[1:]:
            values = table[column].to_pylist()
            if isinstance(values[0], str):
                assert values == [row[column] for row in rows]
            else:
                kind = table[column].to_numpy().dtype
                np.testing.assert_array_equal(
                    np.array([np.nan if value is None else value for value in values], kind),
                    np.array([float(row[column] or 'nan') if kind.kind == 'f' else int(row[column])
                              for row in rows], kind))
        stamps = table['utc'].cast('int64').to_pylist()
        assert stamps == table['stamp_ns'].to_pylist()


def test_what_is_not_known_is_empty(tmp_path: Path) -> None:
    bag = write_run(tmp_path / 'run', leave_out=(
        'truth/attitude', 'attitude_cov', 'attitude_imu', 'protection_level', 'tracks',
        '/diagnostics'))
    export_bag(bag, tmp_path / 'out', ('csv', 'parquet'), LABELS)
    row = read_csv(tmp_path / 'out' / 'attitude.csv')[0]
    assert {row[name] for name in ('cov_xx_rad2', 'rate_x_rad_s', 'error_z_arcsec',
                                   'protection_x_rad')} == {''}
    table = pyarrow.parquet.read_table(tmp_path / 'out' / 'attitude.parquet')
    assert table['error_x_arcsec'].null_count == table.num_rows
    assert read_csv(tmp_path / 'out' / 'tracks.csv') == []
    assert pyarrow.parquet.read_table(tmp_path / 'out' / 'diagnostics.parquet').num_rows == 0


@pytest.mark.parametrize('label', ['', 'two\nlines', 'Jos\u00e9', ' spaces ', 'x' * 300])
def test_labels_that_would_break_the_message_are_refused(label: str) -> None:
    with pytest.raises(AemError, match='object_name'):
        AemLabels(object_name=label)


def call(*arguments: str) -> Result:
    return invoke('export', *arguments)


def test_the_command(run: Path, tmp_path: Path) -> None:
    done = call(str(run), '-o', str(tmp_path / 'out'), '--object-name', 'SAT', '--json')
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document['conditions'] == {'segments': 2}
    assert {Path(row['file']).name for row in document['rows']} == {
        'attitude.aem', 'attitude.csv', 'tracks.csv', 'diagnostics.csv'}
    assert 'OBJECT_NAME = SAT\n' in (tmp_path / 'out' / 'attitude.aem').read_text()


def test_the_command_says_what_cannot_be_done(run: Path, tmp_path: Path) -> None:
    empty = write_run(tmp_path / 'empty', leave_out=('attitude', 'attitude_cov', 'attitude_imu'))
    (tmp_path / 'file').write_text('')
    for arguments, status, words in (
            ([str(tmp_path / 'none')], 1, 'none: No such file or directory'),
            ([str(empty), '-o', str(tmp_path / 'out')], 1, 'holds no attitude'),
            ([str(run), '-o', str(tmp_path / 'file' / 'out')], 1, 'Not a directory'),
            ([str(run), '--object-id', 'a\nb'], 2, 'printable ASCII'),
            ([str(run), '--format', 'xml'], 2, "'xml' is not one of")):
        done = call(*arguments)
        assert done.exit_code == status and isinstance(done.exception, SystemExit), done.output
        assert words in done.stderr


def test_parquet_without_pyarrow_names_it(run: Path, tmp_path: Path) -> None:
    # A module of that name that cannot be imported stands in for none.
    (tmp_path / 'pyarrow.py').write_text('raise ImportError("none")')
    code = ('import sys; sys.path.insert(0, sys.argv.pop(1)); '
            'from startracker_ros.__main__ import main; main()')
    done = subprocess.run(
        [sys.executable, '-c', code, str(tmp_path), 'export', str(run), '-o',
         str(tmp_path / 'out'), '--format', 'parquet'],
        capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 1
    assert 'Parquet needs pyarrow' in done.stderr and 'Traceback' not in done.stderr
    assert not (tmp_path / 'out').exists()
