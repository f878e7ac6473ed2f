# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every message layout survives the way there and back."""

from dataclasses import fields, replace
import itertools

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2, RegionOfInterest
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.maths.rotation import quaternion_from_pointing, rotate, unit_from_radec
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import (
    camera_from_message, CENTROID_DTYPE, image_from_message, MessageError, ns_from_stamp,
    PREDICTION_DTYPE, read_cloud)
from startracker_ros.io.bags.reader import decode
from startracker_ros.ros.diagnostics import status_message, WARN
from startracker_ros.ros.messages.attitude import attitude_to_imu, attitude_to_pose
from startracker_ros.ros.messages.clouds import (
    bodies_from_message, centroids_from_message, centroids_to_message, cloud_to_message,
    predictions_from_message, predictions_to_message, tracks_from_message, tracks_to_message)
from startracker_ros.ros.messages.header import (
    make_header, quaternion_to_geometry, vector_to_geometry)
from startracker_ros.ros.messages.image import (
    camera_to_message, image_message_from_cdr, image_to_message)
from startracker_ros.ros.messages.serialized import deserialized

CAMERA = Camera(640, 480, 3000.0, 3010.0, 320.0, 239.0, (-0.1, 0.01, 1e-3, 2e-3, 0.0))
HEADER = make_header(1_790_000_000_123_456_789, 'star_tracker_optical_frame')


@given(arrays(st.sampled_from(['u1', 'u2']), st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_images(image):
    message = image_to_message(image, HEADER)
    np.testing.assert_array_equal(image_from_message(message).pixels, image)


def test_padded_rows_and_big_endian_images_are_read_right():
    image = np.arange(12, dtype=np.uint16).reshape(3, 4) * 300
    message = image_to_message(image, HEADER)
    padded = np.zeros((3, 10), '>u2')
    padded[:, :4] = image
    message.step, message.is_bigendian = 20, 1
    message.data = padded.tobytes()
    np.testing.assert_array_equal(image_from_message(message).pixels, image)


RNG = np.random.default_rng(5)
COLOURS = RNG.integers(0, 255, (30, 41, 4)).astype(np.uint8)
COLOURS[3, 5], COLOURS[4, 6, 1] = (255, 255, 255, 0), 255
"""The fourth one is not a colour; two pixels are saturated, one of them in one colour."""
MOSAIC = RNG.integers(0, 255, (31, 42)).astype(np.uint8)
MOSAIC_16 = RNG.integers(900, 1100, (64, 80)).astype(np.uint16)


def joined(parts):
    """Return the levels of colours (H, W, C) uint8: the sum, or the largest of 10 bits."""
    return np.where((parts == 255).any(axis=-1), 1023, parts.astype(int).sum(axis=-1))


def cells(mosaic):
    """Return the pixels (H // 2, W // 2, 4) of each cell."""
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    whole = mosaic[:2 * height, :2 * width].reshape(height, 2, width, 2)
    return whole.swapaxes(1, 2).reshape(height, width, 4)


@pytest.mark.parametrize('encodings, pixels, expected', [
    ('mono8 8UC1', MOSAIC, MOSAIC), ('mono16 16UC1', MOSAIC_16, MOSAIC_16),
    ('rgb8 bgr8', COLOURS[..., :3], joined(COLOURS[..., :3])),
    ('rgba8 bgra8', COLOURS, joined(COLOURS[..., :3])),
    ('bayer_rggb8 bayer_bggr8 bayer_gbrg8 bayer_grbg8', MOSAIC, joined(cells(MOSAIC))),
    ('bayer_rggb16 bayer_bggr16 bayer_gbrg16 bayer_grbg16', MOSAIC_16,
     np.floor(cells(MOSAIC_16).mean(axis=-1) + 0.5)),
    ('yuv422 uyvy', COLOURS[..., :2], COLOURS[..., 1]),
    ('yuv422_yuy2 yuyv', COLOURS[..., :2], COLOURS[..., 0])])
def test_encodings_of_drivers(encodings, pixels, expected):
    """Whole, with rows padded by bytes that are not pixels, and in both orders of bytes."""
    height, width = pixels.shape[:2]
    for encoding in encodings.split():
        for order, padding in itertools.product('<>', (0, 6, 7)):
            rows = pixels.astype(pixels.dtype.newbyteorder(order)).reshape(height, -1)
            data = np.pad(rows.view(np.uint8), ((0, 0), (0, padding)), constant_values=201)
            message = Image(height=height, width=width, encoding=encoding,
                            is_bigendian=order == '>', step=data.shape[1], data=data.tobytes())
            found = image_from_message(message)
            np.testing.assert_array_equal(found.pixels, expected)
            assert found.pixels.dtype == (np.uint16 if expected.max() > 255 else np.uint8)
            assert found.cell == 1 + encoding.startswith('bayer')
            found.check_size(Camera.from_fov(width, height, 12.0))
            with pytest.raises(MessageError, match='does not fit camera_info of 50 x 31 px'):
                found.check_size(Camera.from_fov(50, 31, 12.0))
            assert found.in_full().shape == (height // found.cell * found.cell,
                                             width // found.cell * found.cell)


def test_swapped_bytes_are_recognised_by_the_noise():
    """Of 10 bits to 16, in low bits or high; but not of 8 in the upper byte: no star moves."""
    for level, noise, shift in (
            (0, 0.7, 0), (0, 4.0, 6), (100, 0.7, 4), (300, 8.0, 6), (3000, 30.0, 4),
            (2000, 4.0, 0), (20_000, 300.0, 0)):
        image = RNG.normal(level, noise, (300, 200))
        image[::15, ::20] += 4000.0
        image = (image.clip(0, 65535 >> shift).astype(np.uint16) << shift).astype(np.uint16)
        for encoding, swapped in itertools.product(('mono16', 'bayer_rggb16'), (False, True)):
            message = image_to_message(image, HEADER)
            message.encoding, message.is_bigendian = encoding, swapped
            if not swapped:
                assert image_from_message(message).pixels.size
                continue
            with pytest.raises(MessageError, match='bytes of each value are swapped.*'
                               'set is_bigendian to 0'):
                image_from_message(message)
    for upper in (MOSAIC, MOSAIC_16 // 5):
        image = (np.tile(upper, (4, 4)).astype(np.uint16) << 8).astype(np.uint16)
        np.testing.assert_array_equal(
            image_from_message(image_to_message(image, HEADER)).pixels, image)


@given(st.text(st.characters(codec='ascii', exclude_characters='\0'), max_size=9),
       arrays(st.sampled_from(['u1', 'u2']), st.tuples(st.integers(1, 9), st.integers(1, 9))),
       st.integers(-2 ** 31 * 10 ** 9, 2 ** 31 * 10 ** 9 - 1))
def test_serialized_images_are_what_rclpy_reads(frame_id, image, stamp_ns):
    sent = image_to_message(image, make_header(stamp_ns, frame_id))
    data = serialize_message(sent)
    assert image_message_from_cdr(data) == deserialize_message(data, Image)
    for end in range(4, len(data.rstrip(b'\0')) - 1):
        with pytest.raises(MessageError, match='image message of'):
            image_message_from_cdr(data[:end])


def test_what_is_not_little_endian_is_left_to_rclpy():
    other = bytearray(serialize_message(Image(height=1, width=2)))
    other[1] = 0
    for place in (4, 8, 12, 20, 24, 28, 36, 40):
        other[place:place + 4] = other[place:place + 4][::-1]
    assert deserialized(bytes(other), Image).width == 2


def test_stamps_are_whole_nanoseconds():
    assert ns_from_stamp(HEADER.stamp) == 1_790_000_000_123_456_789


def test_camera_info():
    message = camera_to_message(CAMERA, HEADER)
    assert camera_from_message(message) == CAMERA
    message.d = []
    assert camera_from_message(message).distortion == (0.0,) * 5
    # Other decoders give the same.
    message.binning_x = message.binning_y = 2
    message.roi = RegionOfInterest(x_offset=100, y_offset=60, width=400, height=300)
    part = camera_from_message(message)
    assert (part.width, part.height, part.cx, part.cy) == (200, 150, 110.0, 89.5)
    assert part == camera_from_message(decode(cdr.CAMERA_INFO, serialize_message(message)))
    message.d = [0.1] * 8
    with pytest.raises(CameraError, match='5 distortion terms'):
        camera_from_message(message)


def test_camera_info_differs_in_its_stamp_only():
    read = [deserialized(serialize_message(camera_to_message(CAMERA, header)), CameraInfo)
            for header in (HEADER, make_header(5, 'lens'), make_header(7, 'lens'))]
    assert read == [camera_to_message(CAMERA, header) for header in (
        HEADER, make_header(5, 'lens'), make_header(7, 'lens'))]


@pytest.mark.parametrize('values', [{}, {'stars': 3, 'reason': 'é'}])
def test_a_status_is_what_rclpy_writes_and_reads(values):
    message = status_message('star_tracker: state', 'head', WARN, 'LOST', values)
    status = cdr.status(1, 'star_tracker: state', 'LOST', 'head', values)
    assert deserialize_message(status, DiagnosticStatus) == message
    array = cdr.status_array(1_790_000_000_123_456_789, 'star_tracker_optical_frame', status)
    assert deserialize_message(array, DiagnosticArray) == DiagnosticArray(
        header=HEADER, status=[message])
    read = deserialized(status, DiagnosticStatus)
    assert (read.level, read.name, read.message, read.hardware_id) == (
        message.level, message.name, message.message, message.hardware_id)
    assert [tuple(value) for value in read.values] == [
        (value.key, value.value) for value in message.values]
    for end in range(4, len(status) - 1):
        with pytest.raises(MessageError, match='are not status'):
            deserialized(status[:end], DiagnosticStatus)


def cloud_of(data):
    """Return the cloud of bytes, in which rclpy reads the same."""
    cloud, message = deserialized(data, PointCloud2), deserialize_message(data, PointCloud2)
    assert (cloud.header.stamp_ns, cloud.header.frame_id) == (
        ns_from_stamp(message.header.stamp), message.header.frame_id)
    assert cloud.data == bytes(message.data) and message.is_dense
    assert message.row_step == message.width * message.point_step
    for name in ('height', 'width', 'is_bigendian', 'point_step'):
        assert getattr(cloud, name) == getattr(message, name), name
    assert [(f.name, f.offset, f.datatype, 1) for f in cloud.fields] == [
        (f.name, f.offset, f.datatype, f.count) for f in message.fields]
    return cloud


def some_tracks(count):
    rng = np.random.default_rng(count)
    return Tracks(
        hip=np.arange(1, count + 1, dtype=np.int32), magnitude=rng.uniform(0, 6, count),
        uv=rng.uniform(0, 480, (count, 2)), flux=rng.uniform(1, 1e5, count),
        snr=rng.uniform(5, 500, count), sigma_px=rng.uniform(0.01, 1, count),
        residual_px=np.full(count, np.nan), track_id=np.arange(count, dtype=np.uint32) + 70000,
        age=np.full(count, 60000, np.uint16), missed=np.full(count, 3, np.uint8),
        association_probability=rng.uniform(0, 1, count), velocity=rng.normal(0, 5, (count, 2)),
        covariance=np.tile([[0.2, 0.05], [0.05, 0.1]], (count, 1, 1)))


@pytest.mark.parametrize('count', [0, 1, 40])
def test_tracks(count):
    tracks = some_tracks(count)
    again = tracks_from_message(cloud_of(tracks_to_message(tracks, CAMERA, HEADER)))
    for field in fields(Tracks):
        np.testing.assert_allclose(getattr(again, field.name), getattr(tracks, field.name),
                                   rtol=1e-6, atol=1e-6, err_msg=field.name)


@pytest.mark.parametrize('count', [0, 25])
def test_centroids_carry_directions_of_the_camera(count):
    rng = np.random.default_rng(2)
    centroids = Centroids(uv=rng.uniform(0, 480, (count, 2)), flux=np.linspace(9e4, 1e3, count),
                          snr=np.full(count, 30.0), sigma_px=np.full(count, 0.05))
    cloud = cloud_of(centroids_to_message(centroids, CAMERA, HEADER))
    again = centroids_from_message(cloud)
    np.testing.assert_allclose(again.uv, centroids.uv, rtol=1e-6)
    rows = read_cloud(cloud, CENTROID_DTYPE)
    np.testing.assert_allclose(np.stack([rows['x'], rows['y'], rows['z']], -1),
                               CAMERA.unproject(centroids.uv), atol=1e-7)


def test_foreign_field_order_is_read_by_name():
    dtype = np.dtype([('pad', 'f8'), ('sigma_px', 'f4'), ('snr', 'f4'), ('flux', 'f4'),
                      ('v', 'f4'), ('u', 'f4'), ('z', 'f4'), ('y', 'f4'), ('x', 'f4')])
    rows = np.zeros(2, dtype)
    rows['u'], rows['v'], rows['flux'] = [1, 2], [3, 4], [9, 8]
    again = centroids_from_message(cloud_of(cloud_to_message(rows, HEADER)))
    np.testing.assert_array_equal(again.uv, [[1, 3], [2, 4]])


def test_attitude_messages_mean_what_they_say():
    q = quaternion_from_pointing(1.0, -0.4, 2.2)
    sensor = unit_from_radec(np.array([0.1, 0.5, 1.3, 2.0]), np.array([1.2, 1.4, 1.45, 1.3]))
    attitude = estimate_attitude(sensor, rotate(q, sensor), np.full(4, 1e-4))
    pose = deserialize_message(attitude_to_pose(attitude, HEADER), PoseWithCovarianceStamped)
    orientation = pose.pose.pose.orientation
    turned = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w])
    np.testing.assert_allclose(turned.apply(sensor), rotate(q, sensor), atol=1e-9)
    covariance = np.reshape(pose.pose.covariance, (6, 6))
    assert not covariance[:3].any()
    np.testing.assert_allclose(
        covariance[3:, 3:], turned.as_matrix() @ attitude.covariance_sensor
        @ turned.as_matrix().T, atol=1e-15)
    imu = deserialize_message(attitude_to_imu(attitude, HEADER), Imu)
    np.testing.assert_allclose(np.reshape(imu.orientation_covariance, (3, 3)),
                               covariance[3:, 3:], atol=1e-15)
    assert imu.angular_velocity_covariance[0] == -1


def test_invalid_attitude_is_flagged_and_is_not_a_rotation():
    data = attitude_to_imu(None, HEADER)
    for imu in (deserialize_message(data, Imu), deserialized(data, Imu)):
        q = imu.orientation
        assert imu.orientation_covariance[0] == -1
        assert (q.x, q.y, q.z, q.w) == (0, 0, 0, 0)


def test_an_imu_is_what_rclpy_writes():
    rng = np.random.default_rng(4)
    message = Imu(header=HEADER, orientation=quaternion_to_geometry(rng.normal(size=4)),
                  angular_velocity=vector_to_geometry(rng.normal(size=3)),
                  orientation_covariance=rng.normal(size=9),
                  angular_velocity_covariance=rng.normal(size=9))
    read = deserialized(serialize_message(message), Imu)
    assert ns_from_stamp(read.header.stamp) == ns_from_stamp(HEADER.stamp)
    assert read.header.frame_id == HEADER.frame_id
    assert quaternion_to_geometry(np.array(read.orientation)) == message.orientation
    assert vector_to_geometry(np.array(read.angular_velocity)) == message.angular_velocity
    for name in ('orientation_covariance', 'angular_velocity_covariance'):
        np.testing.assert_array_equal(getattr(read, name), getattr(message, name), err_msg=name)


def test_centroids_keep_covariance_row_time_and_how_they_were_found():
    covariance = np.array([[[0.01, 0.004], [0.004, 0.09]], [[0.02, 0.0], [0.0, 0.02]]])
    centroids = Centroids(np.array([[10.0, 20.0], [30.0, 40.0]]), np.ones(2), np.ones(2),
                          np.sqrt([0.05, 0.02]), covariance, np.array([-1e-3, 2e-3]))
    for windowed in (True, False):
        cloud = cloud_of(centroids_to_message(centroids, CAMERA, HEADER, windowed))
        again = centroids_from_message(cloud)
        np.testing.assert_allclose(again.covariance, covariance, rtol=1e-6)
        np.testing.assert_allclose(again.delay_s, centroids.delay_s, rtol=1e-6)
        assert (read_cloud(cloud, CENTROID_DTYPE)['directed'] == windowed).all()


def test_targets_and_bodies_among_the_predictions_are_not_stars():
    predicted = PredictedCentroids(
        1, np.array([[5.0, 6.0], [7.0, 8.0]]), np.zeros((2, 2)), np.array([0.1, 0.2]),
        np.array([11767, 0]), 1)
    bodies = (BodyInImage('Mars', 100.5, 50.25, 1.3, 0.5), BodyInImage('Sun', 9, 8, -26.7, 90.5))
    message = cloud_of(predictions_to_message(predicted, HEADER, bodies))
    assert read_cloud(message, PREDICTION_DTYPE)['body'].tolist() == [0, 10, 3, 9]
    read = predictions_from_message(message, CAMERA)
    assert read.stars == 1 and read.hip.tolist() == [11767, 0]
    assert read.sigma_px == pytest.approx([0.1, 0.2])
    again = bodies_from_message(message)
    assert [body._replace(magnitude=0) for body in again] == [
        body._replace(magnitude=0) for body in bodies]
    alone = cloud_of(predictions_to_message(None, HEADER, bodies))
    assert not len(predictions_from_message(alone, CAMERA).hip)
    assert len(bodies_from_message(alone)) == 2


def test_predictions_of_another_camera_or_nan_are_rejected():
    predicted = PredictedCentroids(
        5_000_000_007, np.array([[10.5, 20.25], [300.0, 100.0]]), np.array([[1.0, -2.0], [0, 3]]),
        np.array([0.1, 0.2]), np.array([71683, 24436]), 2)
    header = make_header(predicted.stamp_ns, 'star_tracker_optical_frame')
    again = predictions_from_message(cloud_of(
        predictions_to_message(predicted, header)), CAMERA)
    for field in fields(PredictedCentroids):
        np.testing.assert_allclose(getattr(again, field.name), getattr(predicted, field.name),
                                   rtol=1e-6)
    nothing = cloud_of(predictions_to_message(None, HEADER))
    assert not predictions_from_message(nothing, CAMERA).stars
    # Stars of a tracker that does not number them, after a target: stars come first.
    mixed = replace(predicted, hip=np.zeros(2, int), stars=1)
    message = cloud_of(predictions_to_message(mixed, header))
    message = message._replace(
        data=message.data[message.point_step:] + message.data[:message.point_step])
    read = predictions_from_message(message, CAMERA)
    assert read.stars == 1
    np.testing.assert_allclose(read.uv, predicted.uv)
    for uv, text in (([1e5, 3.0], 'another camera'), ([np.nan, 3.0], 'not finite')):
        wrong = replace(predicted, uv=np.array([[10.0, 20.0], uv]))
        with pytest.raises(MessageError, match=text):
            predictions_from_message(cloud_of(predictions_to_message(wrong, header)), CAMERA)
