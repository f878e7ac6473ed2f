# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What cannot be right is named, on real nodes; they live on and publish no wrong attitude."""

from itertools import count

from fork_server import ForkedNodes
from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from skies import SMALL_CAMERA as CAMERA, START_NS
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud, STAR_DTYPE
from startracker_ros.ros import qos
from startracker_ros.ros.executables import NODES
from startracker_ros.ros.messages.clouds import cloud_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message, image_to_message


def header(index):
    return make_header(START_NS + index * 100_000_000, 'star_tracker_optical_frame')


def test_no_camera_info(nodes, probe):
    nodes.start('centroid_extractor')
    probe.wait_diagnostic('waiting for camera_info')
    # Its code is loaded already: images are received, and counted as dropped.
    probe.wait(lambda: probe.count_subscribers('image_raw'), 'the subscription of images')


@pytest.mark.parametrize('reliability, words', [
    ('best_effort', 'image_raw: frames are missing: with best effort the default shared memory'),
    ('reliable', 'image_raw: frames are missing')])
def test_a_lossy_image_topic_is_named_with_its_remedy(nodes, probe, reliability, words):
    nodes.start('centroid_extractor', {
        'qos_overrides./image_raw.subscription.reliability': reliability})
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    images = probe.advertise(Image, 'image_raw', qos.IMAGE)
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)))
    indices = count(1)

    def send_five_and_leave_out_one():
        # The usual interval is known after some images, three of them in a row.
        for _ in range(5):
            images.publish(image_to_message(np.zeros((512, 512), np.uint8), header(next(indices))))
        next(indices)
    probe.send_until(send_five_and_leave_out_one, lambda: probe.find_diagnostic(words), words)
    assert bool(probe.find_diagnostic('best effort')) == (reliability == 'best_effort')


def test_cloud_without_a_field_is_refused_by_name(nodes, probe):
    nodes.start('star_identifier')
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)))
    indices = count(1)
    not_finite = np.zeros(3, CENTROID_DTYPE)
    not_finite['u'] = np.nan
    for rows, words in ((np.zeros(3, np.dtype([('x', 'f4'), ('y', 'f4')])),
                         "cloud has no field 'z'"),
                        (not_finite, "cloud field 'u' is not finite in point 0")):
        probe.send_until(
            lambda rows=rows: centroids.publish(cloud_to_message(rows, header(next(indices)))),
            lambda words=words: probe.find_diagnostic(words), words)


def test_too_few_stars_give_no_attitude(nodes, probe):
    for node in ('star_identifier', 'star_tracker', 'attitude_estimator'):
        nodes.start(node)
    for topic in ('stars', 'tracks', 'attitude'):
        probe.collect(PointCloud2 if topic != 'attitude' else QuaternionStamped, topic)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST, subscribers=2)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=3)
    probe.wait(lambda: probe.count_publishers('attitude') and probe.count_publishers('stars')
               and probe.count_publishers('tracks'), 'all nodes')
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)), nodes=3)
    rows = np.zeros(2, CENTROID_DTYPE)
    rows['u'], rows['v'], rows['z'] = (100.0, 300.0), (50.0, 400.0), 1.0
    rows['flux'], rows['snr'], rows['sigma_px'] = 1000.0, 50.0, 0.1
    indices = count(1)
    probe.send_until(lambda: centroids.publish(cloud_to_message(rows, header(next(indices)))),
                     lambda: len(probe.received['stars']) >= 5, 'answers of the identifier',
                     period_s=0.1)
    probe.wait_diagnostic('2 ')
    probe.wait_diagnostic('no attitude')
    assert all(not rows['hip'].any() for rows in (
        read_cloud(cloud, STAR_DTYPE) for cloud in probe.received['stars']))
    assert not probe.received['attitude']


@pytest.fixture
def exit_of(tmp_path):
    """Return a function that runs a node and returns its exit code and what it printed."""
    def run(node, parameters, *extra):
        with ForkedNodes(tmp_path) as nodes:
            code = nodes.start(node, parameters, extra).wait(HANGS_S)
        return code, (tmp_path / f'{node}.log').read_text()
    return run


@pytest.mark.parametrize('node', NODES)
def test_unknown_parameter_stops_the_start(node, exit_of, tmp_path):
    parameters = {'folder': str(tmp_path / 'bag')} if node == 'bag_recorder' else {}
    # What rclpy itself knows is not a mistake.
    known = ['-p', 'use_sim_time:=false', '-p', 'start_type_description_service:=false',
             '-p', 'qos_overrides./image_raw.subscription.depth:=2']
    # With the name of the node, and as it is typed at a prompt.
    name = f'{node}:treshold' if [*NODES].index(node) % 2 else 'treshold'
    code, printed = exit_of(node, parameters, '--ros-args', *known, '-p', f'{name}:=3.0')
    assert code == 2
    assert 'unknown parameter treshold' in printed
    assert 'Traceback' not in printed


def test_the_closest_known_parameter_is_named(exit_of):
    code, printed = exit_of('sky_simulator', {}, '--ros-args', '-p', 'fov:=20.0')
    assert code == 2 and 'unknown parameter fov; did you mean fov_deg?' in printed


@pytest.mark.parametrize('key', ['/star_tracker', '/**/star_tracker', '/**:\n  star_tracker'])
def test_unknown_parameter_in_the_file_of_a_node_stops_the_start(exit_of, tmp_path, key):
    path = tmp_path / 'own.yaml'
    path.write_text(f'{key}: {{ros__parameters: {{min_star: 5}}}}\n')
    code, printed = exit_of('star_tracker', {}, '--ros-args', '--params-file', str(path))
    assert code == 2
    assert 'unknown parameter min_star; did you mean min_stars?' in printed


@pytest.mark.parametrize('node', ['star_tracker', 'composed_pipeline'])
def test_unknown_parameter_for_all_nodes_is_a_warning(nodes, probe, tmp_path, node):
    path = tmp_path / 'all.yaml'
    path.write_text('/**:\n  ros__parameters: {robot: {radius: 0.2}, min_star: 5, max_stars: 30}\n'
                    '/planner:\n  ros__parameters: {horizon_s: 1.0}\n')
    nodes.start(node, extra=['--ros-args', '--params-file', str(path)])
    values = probe.call(GetParameters, '/star_tracker/get_parameters',
                        GetParameters.Request(names=['max_stars'])).values
    assert [value.integer_value for value in values] == [30]
    warnings = [line for line in (tmp_path / f'{node}.log').read_text().splitlines()
                if 'ignored' in line and 'star_tracker' in line]
    assert len(warnings) == 1
    assert 'robot.radius, min_star; did you mean min_stars for min_star?' in warnings[0]


@pytest.mark.parametrize('node, parameters, words', [
    ('sky_simulator', {'frame_rate_hz': -1.0},
     'frame_rate_hz = -1.0 is out of range 0.01 .. 1000 Hz'),
    ('sky_simulator', {'motion': 'spiral'}, "motion = 'spiral' must be one of inertial"),
    ('sky_simulator', {'fov_deg': 12}, 'fov_deg = 12 must be a double: write 12.0'),
    ('sky_simulator', {'camera_file': '/no/such.yaml'}, '/no/such.yaml: No such file'),
    ('sky_simulator', {'start_time_utc': 'soon'}, "start_time_utc = 'soon' is not an ISO 8601"),
    ('image_publisher', {}, 'path is empty'),
    ('image_publisher', {'path': '/no/such'}, '/no/such does not exist'),
    ('attitude_estimator', {'min_stars': 0}, 'min_stars = 0 is out of range 2 .. 100'),
    ('attitude_estimator', {'diagnostic_updater.period': 0.0},
     'diagnostic_updater.period out of range Min: 0.1, Max: 2.0, value: 0.0'),
    ('attitude_estimator', {'source': 'sun'}, "source = 'sun' must be one of tracks, stars"),
    ('bag_recorder', {'folder': '/proc/bag'}, '/proc/bag'),
    ('attitude_estimator', {'qos_overrides./tracks.subscription.reliability': 'often'},
     'qos_overrides of the subscription of tracks: Unexpected QoS override for policy'),
    ('attitude_estimator', {'qos_overrides./tracks.subscription.depth': -3},
     'qos_overrides of the subscription of tracks: Failed to create subscription'),
])
def test_parameter_that_cannot_be_right_stops_the_start(node, parameters, words, exit_of):
    code, printed = exit_of(node, parameters)
    assert code == 2
    assert words in printed
    assert 'Traceback' not in printed


@pytest.mark.parametrize('words, expected', [
    (['-r', '__ns:=/trk//x'], "Couldn't parse remap rule: '-r __ns:=/trk//x'"),
    (['--params-file', '/no/such.yaml'], "parse params file: '--params-file /no/such.yaml'")])
def test_ros_arguments_that_cannot_be_right_stop_the_start(words, expected, exit_of):
    code, printed = exit_of('attitude_estimator', {}, '--ros-args', *words)
    assert code == 2
    assert expected in printed
    assert 'Traceback' not in printed
