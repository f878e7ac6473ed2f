# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of the body over DDS, and publish_tf where tf2_msgs is not installed."""

from importlib.util import find_spec
from itertools import count

from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, PointCloud2
from skies import onboard_stars, SMALL_CAMERA as CAMERA, synthetic_field
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.clouds import stars_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message

STAMP_NS, FRAME = 1_790_000_000_000_000_000, 'star_tracker_optical_frame'
MOUNT = [-0.3618, 0.5012, 0.7391, -0.2671]


def test_the_body_has_the_attitude_of_the_sensor_turned_by_the_mount(nodes, probe):
    nodes.start('attitude_estimator', {
        'source': 'stars', 'aberration': 'none', 'body_frame_id': 'base_link',
        'mount_quaternion': MOUNT})
    for topic in ('attitude', 'attitude_body'):
        probe.collect(QuaternionStamped, topic, qos.LIST)
    stars = probe.advertise(PointCloud2, 'stars', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, make_header(STAMP_NS, FRAME)))
    for topic in ('attitude', 'attitude_body'):
        probe.wait(lambda topic=topic: probe.count_publishers(topic), f'the publisher of {topic}')
    centroids, hip = synthetic_field(onboard_stars(CAMERA, 2026.0), CAMERA)
    stamps_ns = count(STAMP_NS, 100_000_000)

    def both():
        """Return both attitudes of one frame."""
        return next(((sensor, body) for sensor in probe.received['attitude']
                     for body in probe.received['attitude_body']
                     if sensor.header == body.header), None)
    sensor, body = probe.send_until(lambda: stars.publish(stars_to_message(
        centroids, hip, np.zeros(len(hip)), np.zeros(len(hip)), CAMERA,
        make_header(next(stamps_ns), FRAME))), both, 'both attitudes')
    assert body.header.frame_id == 'icrf'
    icrf_from_sensor, icrf_from_body = (
        Rotation.from_quat(quaternion_from_message(message)) for message in (sensor, body))
    assert (icrf_from_body * Rotation.from_quat(MOUNT) * icrf_from_sensor.inv()).magnitude() < 1e-9


@pytest.mark.skipif(find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_publish_tf_without_tf2_msgs_ends_with_the_name_of_the_package(nodes, tmp_path):
    process = nodes.start('attitude_estimator', {'publish_tf': True})
    assert process.wait(HANGS_S) == 2
    log = (tmp_path / 'attitude_estimator.log').read_text()
    assert 'publish_tf needs the package tf2_msgs' in log and 'Traceback' not in log
    # Its end is expected.
    nodes.processes.clear()
