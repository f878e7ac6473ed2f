# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings through the pipeline again: the same bytes in any order, bad bags as rows."""

from dataclasses import replace
import hashlib
import json
from pathlib import Path
import re
import resource
import shutil
import struct

from commands import invoke
import numpy as np
from pictures import assert_legible
import pytest
from shifted_bags import GPS_NS, mosaic, write_shifted
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud
from startracker_ros.io.bags.reader import decode, read_messages, read_topics
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.io.output import OutputError
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.sim.flights.bags import write_bag
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.sim.flights.truth import Truth
from startracker_ros.tools.figures.rows import mean_chi_square_bounds
from startracker_ros.tools.reprocess.compare import compare
from startracker_ros.tools.reprocess.parameters import parameter_sets, ParameterError
from startracker_ros.tools.reprocess.plan import plan_bag, SegmentOptions
from startracker_ros.tools.reprocess.tables import open_run
from startracker_ros.tools.reprocess.tracklets import tracklets
from startracker_ros.tools.reprocess.work import finished
from startracker_ros.tools.trend.trend import hot_pixels, trend

CAMERA = Camera.from_fov(640, 640, 15.0)
FLIGHT = FlightOptions(days=0.0015, bag_hours=1.0, heads=1, magnitude_limit=5.5, fov_deg=15.0)


def hashes(folder):
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for kind in ('bags', 'tables') for path in (folder / kind).rglob('*')
            if path.is_file()}


def errors(folder):
    return json.loads((folder / 'errors.json').read_text())


def test_attitudes_are_right_and_smoothed_better(finished_run):
    _, result = finished_run
    row, = result.records
    assert row['frames'] == 130 and row['with_attitude_percent'] > 97 and row['problems'] == 0
    assert 0.1 < row['cross_rms_arcsec'] < 3.0
    assert row['smoothed_rms_arcsec'] < row['cross_rms_arcsec']
    # One frame in five is independent.
    low, high = mean_chi_square_bounds(3, row['frames'] // 5)
    for name in 'nees', 'smoothed_nees':
        assert low / 2 < row[name] < high, (low / 2, row[name], high)


@pytest.mark.parametrize('clock, shift_ns', [('boot', None), ('GPS time', GPS_NS)])
def test_stamps_of_another_clock_are_named_and_have_a_covariance_that_holds(
        reprocess, tmp_path, clock, shift_ns):
    """Those of GPS time are recognised by the time of recording; exposures are recorded, too."""
    recorded = Path(__file__).parents[3] / 'bags' / 'slew'
    truth = {header.stamp_ns: q for header, q in (
        cdr.read_quaternion(message.data)
        for message in read_messages(recorded, topics=('/truth/attitude',)))}
    shift_ns = shift_ns or min(truth) - 10 ** 11
    bag = write_shifted(recorded, tmp_path / 'bag', shift_ns, exposure_s=0.04)
    result = reprocess([bag], tmp_path / 'run')
    row, = result.records
    assert row['with_attitude_percent'] > 60
    named, = (row for row in errors(tmp_path / 'run') if clock in row['reason'])
    assert named['count'] == row['frames']
    metadata, = (tmp_path / 'run' / 'bags').rglob('metadata.yaml')
    exposures_s = {tuple(read_cloud(cdr.read_point_cloud(message.data), CENTROID_DTYPE)[
        ['exposure_min', 'exposure_max']][0].tolist())
        for message in read_messages(metadata.parent, topics=('/centroids',))}
    assert exposures_s == {(np.float32(0.04), np.float32(0.04))}
    attitudes = load_recording(metadata.parent)
    bounds = attitudes.protection_rad
    assert len(bounds) == len(attitudes.attitude_ns) > 30
    sigma = np.sqrt(np.diagonal(attitudes.covariance_sensor, axis1=1, axis2=2))
    error = np.abs(attitude_error(attitudes.quaternion, np.array(
        [truth[stamp_ns + shift_ns] for stamp_ns in attitudes.attitude_ns])))
    assert (error < 5 * sigma).all() and (error < bounds).all()
    assert np.median(bounds[:, :2]) < 100 * ARCSEC


@pytest.mark.slow
def test_a_bayer_mosaic_has_the_attitudes_of_its_cells(reprocess, tmp_path):
    """camera_info is that of the sensor, with four equal pixels for each one of the recording."""
    recorded, found = Path(__file__).parents[3] / 'bags' / 'slew', {}
    for name, change in (('plain', None), ('mosaic', mosaic)):
        bag = write_shifted(recorded, tmp_path / name, 0, change)
        result = reprocess([bag], tmp_path / f'run_{name}')
        assert not errors(tmp_path / f'run_{name}') and result.records[0]['frames'] == 60
        metadata, = (tmp_path / f'run_{name}' / 'bags').rglob('metadata.yaml')
        found[name] = load_recording(metadata.parent)
    plain, cells = found['plain'], found['mosaic']
    common, one, other = np.intersect1d(
        plain.attitude_ns, cells.attitude_ns, return_indices=True)
    assert len(common) > 0.95 * len(plain.attitude_ns) > 30
    apart = attitude_error(cells.quaternion[other], plain.quaternion[one])
    # A pixel of the recording is 169 arcsec wide; limits in pixels are those of the sensor.
    assert np.median(np.abs(apart[:, :2])) < 0.5 * ARCSEC, np.median(np.abs(apart), axis=0)
    variance, other_variance = (np.diagonal(covariance, axis1=1, axis2=2) for covariance in (
        plain.covariance_sensor[one], cells.covariance_sensor[other]))
    assert 0.8 < np.median(other_variance / variance) < 1.25


def test_bags_are_those_of_the_nodes(finished_run):
    folder, _ = finished_run
    bag, = (folder / 'bags').glob('*/head_1')
    topics = read_topics(bag)
    assert topics['/head_1/attitude'].message_count == 128
    assert topics['/head_1/attitude_imu'].message_count == 130
    recording = load_recording(bag)
    assert recording.complete and not recording.problems
    assert np.all(np.diff(recording.attitude_ns) > 0)
    bounds = [f'protection_{axis}_rad' for axis in 'xyz']
    table = open_run(folder).table('frames', 'head_1', ['stamp_ns', 'q_x', *bounds])
    known = np.isfinite(table['q_x'])
    np.testing.assert_array_equal(table['stamp_ns'][known], recording.attitude_ns)
    np.testing.assert_allclose(table['q_x'][known], recording.quaternion[:, 0], atol=1e-15)
    np.testing.assert_allclose(
        np.stack([table[name][known] for name in bounds], -1), recording.protection_rad, rtol=1e-6)
    assert (recording.protection_rad > recording.sigma_arcsec() * ARCSEC).all()
    ids = [decode(message.type_name, message.data) for message in read_messages(
        bag, topics=('/head_1/tracker_state',))]
    assert {status.message for status in ids} <= {'LOST', 'ACQUIRING', 'TRACKING'}


def test_order_and_a_kill_change_no_byte(flight, reprocess, finished_run, copied_run):
    whole = hashes(finished_run[0])
    records = sorted((copied_run / '.segments').rglob('*.json'))
    assert len(records) == 3
    records[0].unlink()
    damaged = next((copied_run / 'tables').rglob('*_1767225660.parquet'))
    damaged.write_bytes(b'cut')
    (copied_run / '.segments' / '.partial-x' / 'left').mkdir(parents=True)
    row, = reprocess([flight], copied_run, workers=2, smooth=True).records
    assert not (copied_run / '.segments' / '.partial-x').exists()
    assert row['reused'] == 1 and row['segments'] == 3
    assert hashes(copied_run) == whole


def test_a_segment_is_finished_with_its_own_parameters_and_bag_only(flight, finished_run):
    bag, = flight.glob('flight_*')
    segment = plan_bag(bag, bag.name, '', SegmentOptions(segment_s=60.0)).segments[0]
    assert segment.digest({'a': 1}) == segment.digest({'a': 1})
    assert segment.digest({'a': 1}) != segment.digest({'a': 2})
    assert segment.digest({}) != replace(segment, identity='other').digest({})
    assert finished(finished_run[0], segment, segment.digest({})) is None


@pytest.fixture(scope='module')
def bad_bags(tmp_path_factory, flight):
    folder = tmp_path_factory.mktemp('bad')

    def bag(name, *messages):
        with BagWriter(folder / name) as writer:
            for topic, type_name, stamp_ns, data in messages:
                if topic not in writer._topics:
                    writer.add_topic(topic, type_name)
                writer.write(topic, data, stamp_ns, stamp_ns)
    imu = cdr.gyro_imu(10 ** 18, 'camera', np.zeros(3), 1e-3)
    cloud = cdr.point_cloud(10 ** 18, 'camera', np.zeros(0, cdr.np.dtype('u1')))
    bag('foreign', ('/imu', cdr.IMU, 10 ** 18, imu))
    bag('empty')
    bag('no_camera', ('/centroids', cdr.POINT_CLOUD, 10 ** 18, cloud))
    cameras = [cdr.camera_info(10 ** 18, 'camera', camera)
               for camera in (CAMERA, CAMERA.with_focal_ratio(2.0))]
    bag('two_cameras', ('/centroids', cdr.POINT_CLOUD, 10 ** 18, cloud), *(
        ('/camera_info', cdr.CAMERA_INFO, 10 ** 18 + k, cameras[k % 2]) for k in range(20)))
    uncalibrated = cameras[0].replace(struct.pack('<d', CAMERA.fx), bytes(8))
    bag('jitter', ('/centroids', cdr.POINT_CLOUD, 10 ** 18, cloud),
        ('/camera_info', cdr.CAMERA_INFO, 10 ** 18 - 1, uncalibrated), *(
        ('/camera_info', cdr.CAMERA_INFO, 10 ** 18 + k, cdr.camera_info(
            10 ** 18, 'camera', CAMERA.with_focal_ratio(1 + k * 1e-8))) for k in range(20)))
    bag('uncalibrated', ('/centroids', cdr.POINT_CLOUD, 10 ** 18, cloud),
        ('/camera_info', cdr.CAMERA_INFO, 10 ** 18, uncalibrated))
    (folder / 'zero.mcap').write_bytes(b'')
    (folder / 'text.mcap').write_bytes(b'hello, this is text')
    whole, = flight.glob('flight_*/*.mcap')
    (folder / 'cut.mcap').write_bytes(whole.read_bytes()[:-20])
    return folder


def test_each_bad_bag_is_a_row_and_the_good_one_is_done(bad_bags, flight, reprocess, tmp_path):
    bags = [bad_bags / name for name in (
        'foreign', 'empty', 'no_camera', 'two_cameras', 'jitter', 'uncalibrated', 'zero.mcap',
        'text.mcap')]
    result = reprocess([*bags, flight], tmp_path, segment_s=120.0, bag_topics=frozenset())
    reasons = {row['bag']: row['reason'] for row in errors(tmp_path)}
    assert 'no star tracker in it' in reasons['foreign']
    assert 'no messages' in reasons['empty']
    assert 'camera_info' in reasons['no_camera']
    assert 'two cameras' in reasons['two_cameras']
    assert 'cloud has no field' in reasons['jitter']
    assert '/camera_info: focal length (0.0' in reasons['uncalibrated']
    assert 'not an MCAP file' in reasons['zero'] and 'not an MCAP file' in reasons['text']
    assert sum(row['frames'] for row in result.records) == 130


def test_what_is_not_processed_is_named_and_status_1(bad_bags, flight, reprocess, tmp_path):
    bags = [str(bad_bags / name) for name in ('two_cameras', 'text.mcap')]
    options = ['--no-bags', '--segment-s', '120', '--workers', '1', '-o', str(tmp_path / 'run')]
    done = invoke('reprocess', *bags, str(flight), *options)
    assert done.exit_code == 1
    assert re.search(r'run: not processed: text, two_cameras/star_tracker/\d+; see errors.json\n$',
                     done.stderr)
    whole = invoke('reprocess', str(flight), *options)
    assert whole.exit_code == 0 and whole.stderr == ''


def test_of_a_truncated_bag_the_rest_is_used(bad_bags, reprocess, tmp_path):
    row, = reprocess([bad_bags / 'cut.mcap'], tmp_path, segment_s=600.0).records
    assert 'not finished' in errors(tmp_path)[0]['reason']
    assert row['frames'] == 130


def test_a_full_disk_is_a_row_and_the_command_continues_later(flight, reprocess, finished_run,
                                                              tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        row, = reprocess([flight], tmp_path, smooth=True).records
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert row['frames'] == 0
    assert all('File too large' in problem['reason'] for problem in errors(tmp_path))
    row, = reprocess([flight], tmp_path, smooth=True).records
    assert row['frames'] == 130 and errors(tmp_path) == []
    assert hashes(tmp_path) == hashes(finished_run[0])


def test_a_clock_that_jumps_back_is_a_row(flight, reprocess, tmp_path):
    whole, = flight.glob('flight_*')
    with BagWriter(tmp_path / 'jumps') as writer:
        for name, topic in read_topics(whole).items():
            writer.add_topic(name, topic.type_name)
        for number, message in enumerate(read_messages(whole)):
            data = message.data
            if number > 200:
                seconds, = struct.unpack_from('<i', data, 4)
                data = data[:4] + struct.pack('<i', seconds - 600) + data[8:]
            writer.write(message.topic, data, message.log_time_ns, message.log_time_ns)
    row, = reprocess([tmp_path / 'jumps'], tmp_path / 'run', segment_s=600.0).records
    assert row['frames'] == 130 and row['with_attitude_percent'] > 95
    assert ['time went back' in problem['reason'] for problem in errors(tmp_path / 'run')] == [
        True]


def test_no_bag_or_no_right_to_write_is_an_error(flight, reprocess, tmp_path):
    with pytest.raises(BagError, match='no bag there'):
        reprocess([tmp_path / 'nothing'], tmp_path / 'out')
    (tmp_path / 'file').write_text('')
    with pytest.raises(OutputError, match='file: Not a directory'):
        reprocess([flight], tmp_path / 'file')


def test_runs_are_compared(finished_run, copied_run):
    same, = compare(finished_run[0], copied_run).records
    assert same['common'] == 130 and same['first_divergent'] == ''
    assert same['identical'] == 128 and same['largest_arcsec'] == 0
    with pytest.raises(BagError, match='not a finished run'):
        compare(finished_run[0], copied_run / 'tables')


def test_the_picture_of_a_comparison_shows_each_frame(finished_run, copied_run, monkeypatch):
    figures = []
    monkeypatch.setattr('startracker_ros.tools.report.chart.write_picture',
                        lambda path, figure, **options: figures.append(figure))
    compare(finished_run[0], copied_run, Path('difference.png'))
    axes, = figures[0].axes
    assert [len(line.get_xdata()) for line in axes.lines] == 3 * [128]
    assert all(line.get_linewidth() > 0 and line.get_visible() for line in axes.lines)
    assert_legible(figures[0])


def test_frames_of_two_bags_with_the_same_stamps_are_not_mixed(copied_run):
    for path in [*(copied_run / 'tables' / 'frames').rglob('*.parquet')]:
        shutil.copy(path, path.with_name(f'other_{path.stem.rpartition("_")[2]}.parquet'))
    same, = compare(copied_run, copied_run).records
    assert same['frames_a'] == same['frames_b'] == same['common'] == 260
    assert same['identical'] == 256
    assert same['first_divergent'] == same['first_divergent_bag'] == ''


def test_bags_of_the_same_times_are_named(finished_run, copied_run, tmp_path):
    for result in (compare(copied_run, copied_run), trend(copied_run, None, 5800.0)):
        assert 'both hold frames' not in result.conditions.get('note', '')
    for path in [*(copied_run / 'tables').rglob('*.parquet')]:
        shutil.copy(path, path.with_name(f'other_{path.stem.rpartition("_")[2]}.parquet'))
    words = (r'head_1: the bags flight\S+ and other both hold frames of '
             r'2026-01-01T00:00:00\S* to 2026-01-01T00:0\S+: for figures of one')
    for result in (compare(finished_run[0], copied_run),
                   trend(copied_run, tmp_path / 'trend.html', 5800.0)):
        assert re.search(words, result.conditions['note']), result.conditions
    assert re.search(words, (tmp_path / 'trend.html').read_text())


def test_a_run_without_frames_says_so(flight, reprocess, tmp_path):
    """Of clouds that nothing can be read of: two commands, two reasons."""
    topics = read_topics(next(flight.glob('flight_*')))
    with BagWriter(tmp_path / 'bag') as writer:
        for topic in topics.values():
            writer.add_topic(topic.name, topic.type_name)
        for message in read_messages(next(flight.glob('flight_*'))):
            data = message.data
            if message.topic.endswith('/centroids'):
                data = data[:60]
            writer.write(message.topic, data, message.log_time_ns, message.log_time_ns)
    done = invoke('reprocess', str(tmp_path / 'bag'), '-o', str(tmp_path / 'run'), '--workers',
                  '1')
    assert done.exit_code == 1
    assert re.search(r'no frame was processed: bag: /head_1/centroids: .*; see errors.json\n$',
                     done.stderr), done.stderr
    with pytest.raises(BagError, match='the run has no frames, see errors.json'):
        trend(tmp_path / 'run', None, 5800.0)
    with pytest.raises(BagError, match='head_1: the runs have no frame in common: one is of '
                                       'nothing'):
        compare(tmp_path / 'run', tmp_path / 'run')


@pytest.mark.parametrize('write', [
    lambda run, path: trend(run, path, 5800.0), lambda run, path: compare(run, run, path),
    lambda run, path: tracklets(run, path, 'ME')])
def test_a_place_that_cannot_be_written_is_named(finished_run, tmp_path, write):
    (tmp_path / 'file').write_text('a file')
    with pytest.raises(OutputError, match='file/out: '):
        write(finished_run[0], tmp_path / 'file' / 'out')
    assert [*tmp_path.iterdir()] == [tmp_path / 'file']


def test_the_page_of_trends_is_small_and_has_no_script(finished_run, tmp_path):
    result = trend(finished_run[0], tmp_path / 'trend.html', 5800.0)
    assert result.conditions['steps'] == 0
    focal = next(row for row in result.records if row['series'] == 'head_1 focal length')
    assert focal['kind'] == 'drift' and focal['unit'] == '%/d'
    months = [row for row in result.records if row['kind'] == 'median of the month']
    assert [row['utc'] for row in months] == ['2026-01']
    assert months[0]['size'] == pytest.approx(15.0, abs=0.05)
    # Stars of the simulation have errors of 1 / SNR px.
    middle, edge = (row for row in result.records if row['series'].endswith('star images'))
    assert (middle['kind'], edge['kind'], edge['utc']) == ('middle', 'edge', '2026-01')
    for row in (middle, edge):
        assert row['size'] == pytest.approx(np.sqrt(0.5), abs=5 * row['sigma'])
        assert 0 < row['sigma'] < 0.05
    page = (tmp_path / 'trend.html').read_text()
    assert 'alt="width of star images over the image [px, 1 sigma]"' in page
    # Three minutes: no empty axes of years.
    assert 'head_1 focal length: too little data, 2 bins of a minute' in page
    assert len(page) < 1_000_000 and '<script' not in page and 'data:image/svg+xml' in page
    with pytest.raises(BagError, match='not a finished run'):
        trend(tmp_path, tmp_path / 'trend.html', 5800.0)


def test_hot_pixels_are_in_the_map_and_no_objects(reprocess, tmp_path):
    (tmp_path / 'flight').mkdir()
    write_bag(tmp_path / 'flight', replace(FLIGHT, hot_pixels=3), 2, 0)
    reprocess([tmp_path / 'flight'], tmp_path / 'run', segment_s=200.0, bag_topics=frozenset())
    run = open_run(tmp_path / 'run')
    truth = Truth(replace(FLIGHT, hot_pixels=3), 2).hot_pixels(0).astype(int)
    found = hot_pixels(run, 'head_1')
    assert {(row.u, row.v) for row in found} == set(map(tuple, truth.tolist()))
    assert min(row.frames for row in found) > 100
    assert not len(run.table('tracklets', 'head_1', ['stamp_ns'])['stamp_ns'])


def test_parameters_and_sweeps(tmp_path):
    path = tmp_path / 'a.yaml'
    path.write_text('/**/star_tracker:\n  ros__parameters:\n    min_stars: 5\n'
                    '    autostart: true\n')
    sets, unused = parameter_sets([path], [
        'star_tracker.acceleration_deg_s2=0.01,0.1', 'attitude_estimator.solver=svd'])
    assert [item.name for item in sets] == ['acceleration_deg_s2=0.01', 'acceleration_deg_s2=0.1']
    assert sets[1].options.tracker.acceleration_deg_s2 == 0.1
    assert sets[0].options.tracker.min_stars == 5 and unused == ['star_tracker.autostart']
    assert sets[0].options.validation.solver == 'svd'
    for text, reason in (('star_tracker.min_star=4', 'did you mean star_tracker.min_stars'),
                         ('star_tracker.min_stars=1', 'out of range'),
                         ('star_tracker.min_stars', 'NODE.NAME=VALUE'),
                         ('star_tracker.min_stars=4,4', 'the same')):
        with pytest.raises(ParameterError, match=reason):
            parameter_sets((), [text])
