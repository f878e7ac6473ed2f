# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A short run with known figures, written by rosbags as a foreign recorder would."""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, QuaternionStamped, Vector3Stamped
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import Imu, PointCloud2
from skies import onboard_stars
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, quaternion_from_pointing, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks
from startracker_ros.ros.diagnostics import status_message
from startracker_ros.ros.messages.attitude import (
    attitude_to_pose, quaternion_to_message, tracked_attitude_to_imu)
from startracker_ros.ros.messages.clouds import centroids_to_message, tracks_to_message
from startracker_ros.ros.messages.header import make_header, vector_to_geometry
from startracker_ros.ros.messages.image import camera_to_message, image_to_message
from std_msgs.msg import Header

CAMERA = Camera.from_fov(256, 256, 15.0)
START_NS = 1_790_000_000_250_000_000
STEP_NS = 100_000_000
FRAMES = 60
# Frames without an attitude: at the start, and where the lock is lost.
UNSOLVED = (0, 1, 30, 31, 32)
SIGMA_ARCSEC = np.array([2.0, 3.0, 20.0])
PROTECTION_ARCSEC = np.array([12.0, 18.0, 120.0])
RATE_RAD_S = np.radians([0.2, 0.1, 0.05])
HOSTILE = '</script><img src=x onerror="alert(1)"> & \u2028'
# When the messages of a frame are sent, ms after its stamp.
SENT_MS = {'image_raw': 10, 'centroids': 22, 'tracks': 27, 'attitude': 29}

_STORE = get_typestore(Stores.ROS2_JAZZY)


def truth(frame: int) -> np.ndarray:
    """Return q_icrf_from_sensor (4,) of a frame; w goes from positive to negative."""
    start = quaternion_from_pointing(*np.radians([359.7, 40.0, 179.5]))
    return multiply(start, quaternion_from_rotation_vector(RATE_RAD_S * 0.1 * frame))


def error_arcsec(frame: int) -> np.ndarray:
    """Return the error (3,) about sensor axes that the attitude of a frame has."""
    return SIGMA_ARCSEC * np.random.default_rng(frame).normal(size=3)


def protection_rad(frame: int) -> np.ndarray:
    """Return the protection level (3,) rad of a frame: frame 2 has no bound about z."""
    return np.where([False, False, frame == 2], np.inf, PROTECTION_ARCSEC * ARCSEC)


def attitude(frame: int) -> AttitudeEstimate:
    """Return the attitude that the run has of a frame."""
    q = multiply(truth(frame), quaternion_from_rotation_vector(error_arcsec(frame) * ARCSEC))
    return AttitudeEstimate(q, np.diag((SIGMA_ARCSEC * ARCSEC) ** 2), 9, np.zeros(0), 0.0)


def write_run(folder: Path, *, leave_out: tuple[str, ...] = (), namespace: str = '',
              change: Callable[[str, Any], Any] | None = None,
              delay_ns: Callable[[str, int], int] = lambda topic, time_ns: 0,
              damage: Callable[[bytes], bytes] = bytes) -> Path:
    """
    Write a bag without the topics of leave_out.

    change(topic, message) may swap messages, or leave one out as None, damage(data) their bytes.
    delay_ns(topic, time_ns) is how much later a message is sent.
    """
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[tuple[str, str], Any] = {}
        for time_ns, topic, kind, data in _serialized():
            if topic in leave_out:
                continue
            if change:
                message = change(topic, deserialize_message(data, kind))
                if message is None:
                    continue
                kind, data = type(message), serialize_message(message)
            name = topic if topic.startswith('/') else f'{namespace}/{topic}'
            type_name = '/'.join((kind.__module__.split('.')[0], 'msg', kind.__name__))
            if (name, type_name) not in connections:
                connections[name, type_name] = writer.add_connection(
                    name, type_name, typestore=_STORE)
            writer.write(connections[name, type_name], time_ns + delay_ns(topic, time_ns),
                         damage(data))
    return folder


@cache
def _serialized() -> list[tuple[int, str, type, bytes]]:
    """Return log time, topic, type and bytes of all messages, sorted by log time."""
    return [(time_ns, topic, type(message), serialize_message(message))
            for time_ns, topic, message in sorted(_messages(), key=lambda row: row[0])]


def _attitude(quaternion: np.ndarray, header: Header) -> QuaternionStamped:
    return deserialize_message(quaternion_to_message(quaternion, header), QuaternionStamped)


def _messages() -> Iterator[tuple[int, str, Any]]:
    onboard = onboard_stars(CAMERA, 2026.5, 6.0)
    for frame in range(FRAMES):
        stamp_ns = START_NS + frame * STEP_NS
        header = make_header(stamp_ns, 'star_tracker_optical_frame')
        inertial = make_header(stamp_ns, 'icrf')
        state = {0: 'LOST', 1: 'ACQUIRING', 30: 'LOST', 31: 'LOST', 32: 'ACQUIRING'}.get(
            frame, 'TRACKING')
        q = truth(frame)
        directions = rotate(conjugate(q), onboard.direction)
        uv = CAMERA.project(directions)
        seen = (directions[:, 2] > 0.5) & CAMERA.contains(uv)
        count = int(np.count_nonzero(seen))
        flux = 10 ** (4 - 0.4 * onboard.magnitude[seen])
        found = Centroids(uv[seen], flux, np.full(count, 50.0), np.full(count, 0.1))
        solved = frame not in UNSOLVED
        rows = [
            ('image_raw', image_to_message(_image(uv[seen], flux), header)),
            ('camera_info', camera_to_message(CAMERA, header)),
            ('truth/attitude', _attitude(q, inertial)),
            ('centroids', deserialize_message(
                centroids_to_message(found, CAMERA, header), PointCloud2)),
            ('tracks', deserialize_message(tracks_to_message(
                _tracks(uv[seen], flux, onboard.hip[seen], onboard.magnitude[seen]), CAMERA,
                header), PointCloud2)),
            ('tracker_state', status_message(
                'star_tracker: state', 'st0', DiagnosticStatus.OK, state, {})),
            ('attitude_imu', deserialize_message(tracked_attitude_to_imu(
                TrackedAttitude(attitude(frame), RATE_RAD_S, np.eye(3) * 1e-10)
                if solved else None, header), Imu))]
        if solved:
            rows += [
                ('attitude', _attitude(
                    # The sign of a quaternion says nothing, and may change from frame to frame.
                    attitude(frame).quaternion * (-1) ** frame, inertial)),
                ('attitude_cov', deserialize_message(
                    attitude_to_pose(attitude(frame), inertial), PoseWithCovarianceStamped)),
                ('protection_level', Vector3Stamped(
                    header=header, vector=vector_to_geometry(protection_rad(frame))))]
        if frame % 10 == 0:
            rows.append(('/diagnostics', DiagnosticArray(header=header, status=[
                status_message(f'star_tracker: {HOSTILE}', HOSTILE, DiagnosticStatus.WARN
                               if frame == 0 else DiagnosticStatus.OK, f'{state} {HOSTILE}',
                               {f'key {HOSTILE}': HOSTILE, 'frames': frame})])))
        for topic, message in rows:
            yield stamp_ns + SENT_MS.get(topic, 28) * 10 ** 6, topic, message


def _image(uv: np.ndarray, flux: np.ndarray) -> np.ndarray:
    image = np.random.default_rng(1).normal(100, 5, (CAMERA.height, CAMERA.width))
    for (u, v), light in zip(uv.round().astype(int), flux):
        image[v, u] += light
    return image.clip(0, 65535).astype(np.uint16)


def _tracks(uv: np.ndarray, flux: np.ndarray, hip: np.ndarray, magnitude: np.ndarray) -> Tracks:
    count = len(uv)
    missed = np.zeros(count, np.uint8)
    missed[-1] = 2
    hip = hip.copy()
    hip[0] = 0
    return Tracks(
        hip=hip, magnitude=np.where(hip > 0, magnitude, np.nan), uv=uv, flux=flux,
        snr=np.full(count, 50.0), sigma_px=np.full(count, 0.1),
        residual_px=np.where(missed > 0, np.nan, 0.25), track_id=np.arange(count, dtype=np.uint32),
        age=np.full(count, 3, np.uint16), missed=missed,
        association_probability=np.full(count, 0.99), velocity=np.zeros((count, 2)),
        covariance=np.tile(np.eye(2) * 0.01, (count, 1, 1)))
