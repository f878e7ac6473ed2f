"""What cannot be right is named, on real nodes; they live on and publish no wrong attitude."""

import subprocess

from geometry_msgs.msg import QuaternionStamped
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from startracker_ros.bag.layouts import CENTROID_DTYPE, ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.executables import NODES
from startracker_ros.harness.processes import node_command, node_environment, parameter_arguments
from startracker_ros.ros import qos
from startracker_ros.ros.messages.camera_info import camera_to_message
from startracker_ros.ros.messages.clouds import cloud_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(512, 512, 12.0)
START_NS = 1_790_000_000_000_000_000


def header(index):
    return make_header(START_NS + index * 100_000_000, 'star_tracker_optical_frame')


@pytest.fixture(scope='module')
def sky():
    """One good image of the sky."""
    simulator = SkySimulator(CAMERA, motion_from_options(MotionOptions()),
                             load_catalog().brighter_than(7.0), 2026.7)
    return simulator.frame(0.0).image


class Extractor:
    """A running centroid_extractor with publishers to it."""

    def __init__(self, nodes, probe):
        nodes.start('centroid_extractor')
        self.probe = probe
        self.index = 0
        probe.collect(PointCloud2, 'centroids')
        self.camera_info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
        self.camera_info.publish(camera_to_message(CAMERA, header(0)))
        self.image = probe.advertise(Image, 'image_raw', qos.IMAGE)
        probe.wait(lambda: probe.count_publishers('centroids'), 'centroids offered')

    def send(self, image, camera_info=None, **changes):
        """Send an image, changed or not, with its camera_info."""
        self.index += 1
        if camera_info is None:
            camera_info = camera_to_message(CAMERA, header(self.index))
        if camera_info is not False:
            self.camera_info.publish(camera_info)
            self.probe.spin_for(0.1)
        message = image_to_message(image, header(self.index))
        for name, value in changes.items():
            setattr(message, name, value)
        self.image.publish(message)
        return ns_from_stamp(message.header.stamp)

    def still_works(self, sky):
        """Send a good image after the bad one: it is answered with stars."""
        self.index += 1
        stamp_ns = self.send(sky)
        cloud = self.probe.wait(lambda: next(
            (c for c in self.probe.received['centroids']
             if ns_from_stamp(c.header.stamp) == stamp_ns), None), 'centroids')
        assert cloud.width > 5


@pytest.fixture
def extractor(nodes, probe):
    return Extractor(nodes, probe)


@pytest.mark.parametrize('changes, words', [
    ({'encoding': 'rgb8'}, "image encoding 'rgb8' is not mono8 or mono16"),
    ({'encoding': '32FC1'}, "image encoding '32FC1'"),
    ({'width': 0, 'height': 0}, 'image size 0 x 0 is empty'),
    ({'height': 4000}, 'is too short for 512 x 4000'),
    ({'width': 500}, 'does not fit camera_info'),
])
def test_image_that_is_none(extractor, probe, sky, changes, words):
    extractor.send(sky, **changes)
    probe.wait_diagnostic(words)
    assert not probe.received['centroids']
    extractor.still_works(sky)


@pytest.mark.parametrize('field, value, words', [
    ('k', [float('nan')] * 9, 'NaN or infinity'),
    ('k', [0.0] * 9, 'focal length (0.0, 0.0) px must be positive'),
    ('distortion_model', 'fisheye', "'fisheye' is not plumb_bob"),
    ('width', 0, 'image size 0 x 512'),
])
def test_camera_info_that_is_none(extractor, probe, sky, field, value, words):
    info = camera_to_message(CAMERA, header(1))
    setattr(info, field, value)
    extractor.send(sky, camera_info=info)
    probe.wait_diagnostic(words)
    probe.wait_diagnostic('no valid camera_info received')
    assert not probe.received['centroids']
    extractor.still_works(sky)


def test_no_camera_info(nodes, probe):
    nodes.start('centroid_extractor')
    probe.wait_diagnostic('waiting for camera_info')
    assert not probe.count_subscribers('image_raw')


@pytest.mark.parametrize('value', [0, 65535])
def test_black_and_white_images_hold_no_star(extractor, probe, sky, value):
    extractor.send(np.full_like(sky, value))
    cloud = probe.wait(lambda: probe.received['centroids'], 'an empty cloud')[0]
    assert cloud.width == 0
    status = probe.wait(lambda: next((s for s in probe.statuses() if 'centroid_extractor' in s.name
                                      and 'received' not in s.message), None), 'a condition')
    assert status.level == b'\x01' and status.message
    extractor.still_works(sky)


def test_image_out_of_order_is_counted_and_dropped(extractor, probe, sky):
    extractor.index = 10
    extractor.still_works(sky)
    extractor.index = 8
    late_ns = extractor.send(sky)
    probe.wait(lambda: any(v.key == 'image_raw out of order' and v.value == '1'
                           for s in probe.statuses() for v in s.values), 'the count')
    assert all(ns_from_stamp(c.header.stamp) != late_ns
               for c in probe.received['centroids'])
    extractor.index = 12
    extractor.still_works(sky)


def test_cloud_without_a_field_is_refused_by_name(nodes, probe):
    nodes.start('star_identifier')
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
    info.publish(camera_to_message(CAMERA, header(0)))
    rows = np.zeros(3, np.dtype([('x', 'f4'), ('y', 'f4')]))
    centroids.publish(cloud_to_message(rows, header(1)))
    probe.wait_diagnostic("cloud has no field 'z'")
    rows = np.zeros(3, CENTROID_DTYPE)
    rows['u'] = np.nan
    centroids.publish(cloud_to_message(rows, header(2)))
    probe.wait_diagnostic("cloud field 'u' is not finite in point 0")


def test_too_few_stars_give_no_attitude(nodes, probe):
    for node in ('star_identifier', 'star_tracker', 'attitude_estimator'):
        nodes.start(node)
    for topic in ('stars', 'tracks', 'attitude'):
        probe.collect(PointCloud2 if topic != 'attitude' else QuaternionStamped, topic)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=3)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST, subscribers=2)
    probe.wait(lambda: probe.count_publishers('attitude') and probe.count_publishers('stars')
               and probe.count_publishers('tracks'), 'all nodes')
    info.publish(camera_to_message(CAMERA, header(0)))
    probe.spin_for(1.0)
    rows = np.zeros(2, CENTROID_DTYPE)
    rows['u'], rows['v'], rows['z'] = (100.0, 300.0), (50.0, 400.0), 1.0
    rows['flux'], rows['snr'], rows['sigma_px'] = 1000.0, 50.0, 0.1
    for index in range(1, 6):
        centroids.publish(cloud_to_message(rows, header(index)))
        probe.spin_for(0.1)
    probe.wait(lambda: len(probe.received['stars']) >= 5, 'answers of the identifier')
    probe.wait_diagnostic('2 ')
    probe.wait_diagnostic('no attitude')
    assert all(not rows['hip'].any() for rows in (
        read_cloud(cloud, STAR_DTYPE) for cloud in probe.received['stars']))
    assert not probe.received['attitude']


def run_node(node, parameters, timeout_s=300):
    return subprocess.run(node_command(node, parameter_arguments(parameters)), timeout=timeout_s,
                          env=node_environment(), capture_output=True, text=True)


@pytest.mark.parametrize('node', NODES)
def test_unknown_parameter_stops_the_start(node, tmp_path):
    parameters = {'treshold': 3.0}
    if node == 'bag_recorder':
        parameters['folder'] = str(tmp_path / 'bag')
    done = run_node(node, parameters)
    assert done.returncode == 2
    assert 'unknown parameter treshold' in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr


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
    ('attitude_estimator', {'source': 'sun'}, "source = 'sun' must be one of tracks, stars"),
    ('bag_recorder', {'folder': '/proc/bag'}, '/proc/bag'),
])
def test_parameter_that_cannot_be_right_stops_the_start(node, parameters, words):
    done = run_node(node, parameters)
    assert done.returncode == 2
    assert words in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr
