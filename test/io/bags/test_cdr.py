# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""CDR written without ROS, read by an independent library, and the other way."""

from contextlib import suppress

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, MessageError, read_cloud, TRACK_DTYPE
from startracker_ros.io.bags.reader import decode
from startracker_ros.io.bags.telemetry import rate_from_imu

STAMP_NS = 1_700_000_000_123_456_789
Q = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
COVARIANCE = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]]) * 1e-9


def rows(dtype, count, seed=1):
    found = np.zeros(count, dtype)
    rng = np.random.default_rng(seed)
    for name in dtype.names:
        found[name] = (rng.normal(size=count) if dtype[name].kind == 'f'
                       else rng.integers(0, 200, count))
    return found


def written(frame):
    camera = Camera(640, 480, 700.0, 701.0, 320.0, 240.0, (0.1, -0.2, 0.001, 0.002, 0.0))
    yield cdr.POINT_CLOUD, cdr.point_cloud(STAMP_NS, frame, rows(TRACK_DTYPE, 3))
    yield cdr.POINT_CLOUD, cdr.point_cloud(STAMP_NS, frame, rows(CENTROID_DTYPE, 0))
    yield cdr.IMU, cdr.imu(STAMP_NS, frame, Q, COVARIANCE, np.arange(3.0), COVARIANCE)
    yield cdr.IMU, cdr.imu(STAMP_NS, frame, None, None)
    yield cdr.IMU, cdr.gyro_imu(STAMP_NS, frame, np.arange(3.0), 1e-5)
    yield cdr.QUATERNION, cdr.quaternion_stamped(STAMP_NS, frame, Q)
    yield cdr.POSE, cdr.pose_stamped(STAMP_NS, frame, Q, COVARIANCE)
    yield cdr.VECTOR, cdr.vector_stamped(STAMP_NS, frame, np.array([1e-5, 2e-5, np.inf]))
    yield cdr.TRANSFORM, cdr.transform(STAMP_NS, frame, 'sensor', Q)
    yield cdr.ODOMETRY, cdr.odometry(STAMP_NS, frame, 'icrf', np.arange(3.0), np.ones(3), 1., 2.)
    yield cdr.CAMERA_INFO, cdr.camera_info(STAMP_NS, frame, camera)
    fisheye = Camera.from_fov(640, 480, 150.0, 'equidistant')
    yield cdr.CAMERA_INFO, cdr.camera_info(STAMP_NS, frame, fisheye)
    for ends in (np.arange(8.0).reshape(4, 2), np.empty((0, 2))):
        yield 'visualization_msgs/msg/ImageMarker', cdr.image_lines(
            STAMP_NS, frame, 'centroids', ends, 1.5, (1.0, 0.75, 0.25, 1.0))
    yield cdr.STATUS, cdr.status(1, 'star_tracker: state', 'LOST', frame, {'stars': 3, 'r': 'x'})


@pytest.mark.parametrize('frame', ['', 'a', 'icrf', 'star_tracker_optical_frame'])
def test_rosbags_writes_the_same_bytes(store, frame):
    for name, data in written(frame):
        message = store.deserialize_cdr(data, name)
        assert bytes(store.serialize_cdr(message, name)) == data, name


def test_values_arrive():
    message = decode(cdr.POSE, cdr.pose_stamped(STAMP_NS, 'icrf', Q, COVARIANCE))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (
        1_700_000_000, 123_456_789)
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6))[3:, 3:], COVARIANCE)
    message = decode(cdr.ODOMETRY, cdr.odometry(
        STAMP_NS, 'icrf', 'icrf', np.arange(3.0), np.ones(3), 4.0, 9.0))
    assert message.pose.pose.position.z == 2.0 and message.twist.twist.linear.x == 1.0
    assert np.reshape(message.twist.covariance, (6, 6))[1, 1] == 9.0


@pytest.mark.parametrize('frame', ['', 'abc', 'star_tracker_optical_frame'])
@pytest.mark.parametrize('dtype', [CENTROID_DTYPE, TRACK_DTYPE])
def test_clouds_are_read_as_they_were_written(frame, dtype):
    for count in (0, 1, 7):
        sent = rows(dtype, count, count)
        cloud = cdr.read_point_cloud(cdr.point_cloud(STAMP_NS + count, frame, sent))
        assert cloud.header == (STAMP_NS + count, frame)
        np.testing.assert_array_equal(read_cloud(cloud, dtype), sent)


def test_clouds_of_two_layouts_are_not_confused():
    for _ in range(2):
        for dtype in (CENTROID_DTYPE, TRACK_DTYPE):
            cloud = cdr.read_point_cloud(cdr.point_cloud(1, 'x', rows(dtype, 2)))
            assert [f.name for f in cloud.fields] == list(dtype.names)


def test_rates_are_those_of_the_decoder():
    data = cdr.imu(STAMP_NS, 'body', Q, COVARIANCE, np.array([1.0, 2.0, 3.0]), COVARIANCE)
    rates = cdr.read_rates(data)
    assert rates.header == (STAMP_NS, 'body')
    np.testing.assert_array_equal(rates.rate_rad_s, rate_from_imu(decode(cdr.IMU, data)))
    assert rates.covariance[0] == COVARIANCE[0, 0]
    assert cdr.read_rates(cdr.imu(STAMP_NS, 'body', Q, COVARIANCE)).covariance[0] == -1


def test_damaged_bytes_are_rejected():
    data = cdr.point_cloud(STAMP_NS, 'camera', rows(CENTROID_DTYPE, 3))
    for size in range(0, len(data) - 1, 7):
        with pytest.raises(MessageError):
            cdr.read_point_cloud(data[:size])
    imu = cdr.imu(STAMP_NS, 'camera', Q, COVARIANCE)
    for size in range(0, len(imu) - 1, 11):
        with pytest.raises(MessageError):
            cdr.read_rates(imu[:size])
    rng = np.random.default_rng(3)
    for _ in range(300):
        damaged = bytearray(data)
        damaged[rng.integers(4, len(data))] = rng.integers(256)
        with suppress(MessageError):
            read_cloud(cdr.read_point_cloud(bytes(damaged)), CENTROID_DTYPE)
