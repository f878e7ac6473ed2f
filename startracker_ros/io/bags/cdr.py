# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Messages of this package as CDR, little-endian, written and read without ROS.

The bytes are those that rclpy serializes. Tools that write millions of messages use them.
"""

from collections.abc import Mapping
from functools import lru_cache
import struct
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.bags.layouts import MessageError, POINT_FIELD_TYPES, rotation_covariance

POINT_CLOUD, IMU = 'sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Imu'
QUATERNION, POSE = ('geometry_msgs/msg/QuaternionStamped',
                    'geometry_msgs/msg/PoseWithCovarianceStamped')
VECTOR = 'geometry_msgs/msg/Vector3Stamped'
TRANSFORM, ODOMETRY = 'geometry_msgs/msg/TransformStamped', 'nav_msgs/msg/Odometry'
CAMERA_INFO, STATUS = 'sensor_msgs/msg/CameraInfo', 'diagnostic_msgs/msg/DiagnosticStatus'

_ENCAPSULATION = b'\x00\x01\x00\x00'
_STAMP = struct.Struct('<iI')
_UINT = struct.Struct('<I')
_UNKNOWN = np.array([-1.0, *[0.0] * 8])
_LINE_LIST = 2
_NO_ROTATION, _ZERO = np.zeros(4), np.zeros(3)
_MOST_LAYOUTS = 64


class PointCloud(NamedTuple):
    """The fields of a PointCloud2 that are used; header and fields have its attributes."""

    header: 'Header'
    height: int
    width: int
    fields: tuple['PointField', ...]
    is_bigendian: bool
    point_step: int
    data: bytes


class Image(NamedTuple):
    """An Image; data shows the bytes that it was read from."""

    header: 'Header'
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: memoryview


class Stamp(NamedTuple):
    """A stamp with the names that messages have."""

    sec: int
    nanosec: int


class Header(NamedTuple):
    """Stamp in ns and frame of a message."""

    stamp_ns: int
    frame_id: str

    @property
    def stamp(self) -> Stamp:
        """Return the stamp as messages have it."""
        return Stamp(*divmod(self.stamp_ns, 1_000_000_000))


class PointField(NamedTuple):
    """A field of a cloud."""

    name: str
    offset: int
    datatype: int


class Quaternion(NamedTuple):
    """Components with the names that messages have."""

    x: float
    y: float
    z: float
    w: float


class Vector(NamedTuple):
    """Components with the names that messages have."""

    x: float
    y: float
    z: float


class Imu(NamedTuple):
    """An Imu without its acceleration; the covariances are (9,)."""

    header: Header
    orientation: Quaternion
    orientation_covariance: np.ndarray
    angular_velocity: Vector
    angular_velocity_covariance: np.ndarray


class KeyValue(NamedTuple):
    """A value of a status, as text."""

    key: str
    value: str


class Status(NamedTuple):
    """A DiagnosticStatus."""

    level: bytes
    name: str
    message: str
    hardware_id: str
    values: tuple[KeyValue, ...]


class Rates(NamedTuple):
    """What an Imu says of the body rate: rate (3,) rad/s and its covariance (9,)."""

    header: Header
    rate_rad_s: np.ndarray
    covariance: np.ndarray


# --- writing ---

class _Body:
    """Bytes of a message; alignment counts from behind the encapsulation."""

    def __init__(self, stamp_ns: int | None = None, frame_id: str = '') -> None:
        self._bytes = bytearray(_ENCAPSULATION)
        if stamp_ns is not None:
            self._bytes += _STAMP.pack(*divmod(int(stamp_ns), 1_000_000_000)) + _string(frame_id)

    def uints(self, *values: int) -> '_Body':
        self._align(4)
        self._bytes += struct.pack(f'<{len(values)}I', *values)
        return self

    def doubles(self, *parts: Any) -> '_Body':
        """Append arrays or sequences of float64."""
        self._align(8)
        self._bytes += np.concatenate(parts, axis=None, dtype='<f8').tobytes()
        return self

    def text(self, value: str) -> '_Body':
        self._align(4)
        self._bytes += _string(value)
        return self

    def raw(self, value: bytes) -> '_Body':
        self._bytes += value
        return self

    def done(self) -> bytes:
        return bytes(self._bytes)

    def _align(self, size: int) -> None:
        self._bytes += bytes(-(len(self._bytes) - 4) % size)


@lru_cache(maxsize=64)
def _string(value: str) -> bytes:
    data = value.encode() + b'\0'
    return _UINT.pack(len(data)) + data


def point_cloud(stamp_ns: int, frame_id: str, rows: np.ndarray) -> bytes:
    """Return the PointCloud2 of structured rows (N,)."""
    return (_Body(stamp_ns, frame_id).uints(1, len(rows)).raw(_fields(rows.dtype))
            .uints(rows.dtype.itemsize, rows.nbytes, rows.nbytes)
            .raw(rows.tobytes()).raw(b'\1').done())


@lru_cache(maxsize=16)
def _fields(dtype: np.dtype) -> bytes:
    """Return the array of PointField of a dtype, and is_bigendian, from a multiple of 4 on."""
    body, fields = _Body(), dict(dtype.fields or {})
    body.uints(len(fields))
    for name, (kind, offset, *_) in fields.items():
        body.text(name).uints(offset).raw(bytes([POINT_FIELD_TYPES[kind.str[1:]]])).uints(1)
    return body.raw(b'\0').done()[4:]


def imu(stamp_ns: int, frame_id: str, quaternion: np.ndarray | None,
        covariance: np.ndarray | None, rate_rad_s: np.ndarray | None = None,
        rate_covariance: np.ndarray | None = None) -> bytes:
    """Return an Imu; what is None is marked as unknown, a quaternion by zeros."""
    return _Body(stamp_ns, frame_id).doubles(
        _NO_ROTATION if quaternion is None else quaternion,
        _UNKNOWN if covariance is None else covariance,
        _ZERO if rate_rad_s is None else rate_rad_s,
        _UNKNOWN if rate_covariance is None else rate_covariance, _ZERO, _UNKNOWN).done()


def gyro_imu(stamp_ns: int, frame_id: str, rate_rad_s: np.ndarray, sigma_rad_s: float) -> bytes:
    """Return the Imu of a gyro: no orientation, no acceleration."""
    return imu(stamp_ns, frame_id, np.array([0.0, 0.0, 0.0, 1.0]), _UNKNOWN, rate_rad_s,
               np.eye(3) * sigma_rad_s ** 2)


def quaternion_stamped(stamp_ns: int, frame_id: str, quaternion: np.ndarray) -> bytes:
    """Return a QuaternionStamped of (4,)."""
    return _Body(stamp_ns, frame_id).doubles(quaternion).done()


def vector_stamped(stamp_ns: int, frame_id: str, vector: np.ndarray) -> bytes:
    """Return a Vector3Stamped of (3,)."""
    return _Body(stamp_ns, frame_id).doubles(vector).done()


def pose_stamped(stamp_ns: int, frame_id: str, quaternion: np.ndarray, covariance: np.ndarray
                 ) -> bytes:
    """Return a PoseWithCovarianceStamped at the origin; (3, 3) rad^2 is about the frame's axes."""
    return _Body(stamp_ns, frame_id).doubles(
        _ZERO, quaternion, rotation_covariance(covariance)).done()


def transform(stamp_ns: int, frame_id: str, child_frame_id: str, quaternion: np.ndarray) -> bytes:
    """Return a TransformStamped without translation."""
    return (_Body(stamp_ns, frame_id).text(child_frame_id)
            .doubles(_ZERO, quaternion).done())


def odometry(stamp_ns: int, frame_id: str, child_frame_id: str, position_m: np.ndarray,
             velocity_m_s: np.ndarray, position_variance: float, velocity_variance: float
             ) -> bytes:
    """Return an Odometry, all on the axes of its frame: no rotation."""
    pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
    pose[:3, :3], twist[:3, :3] = position_variance * np.eye(3), velocity_variance * np.eye(3)
    return (_Body(stamp_ns, frame_id).text(child_frame_id)
            .doubles(position_m, [0.0, 0.0, 0.0, 1.0], pose, velocity_m_s, np.zeros(3), twist)
            .done())


def camera_info(stamp_ns: int, frame_id: str, camera: Camera) -> bytes:
    """Return the CameraInfo of a camera."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    return (_Body(stamp_ns, frame_id).uints(camera.height, camera.width)
            .text(camera.distortion_model).uints(len(camera.distortion))
            .doubles(camera.distortion, k, np.eye(3), p)
            .uints(0, 0, 0, 0, 0, 0).raw(b'\0').done())


def image_lines(stamp_ns: int, frame_id: str, namespace: str, ends: np.ndarray, width_px: float,
                colour: tuple[float, float, float, float]) -> bytes:
    """Return an ImageMarker of lines, each between two successive pixels of ends (2N, 2)."""
    body = (_Body(stamp_ns, frame_id).text(namespace).uints(0, _LINE_LIST, 0).doubles(_ZERO)
            .raw(struct.pack('<5f', width_px, *colour)).raw(b'\0')
            .uints(0, 0, 0, 0, 0, 0, len(ends)))
    if len(ends):
        body.doubles(np.pad(ends, ((0, 0), (0, 1))))
    return body.uints(0).done()


def status(level: int, name: str, message: str, hardware_id: str,
           values: Mapping[str, object]) -> bytes:
    """Return a DiagnosticStatus with values as text."""
    body = _Body().raw(bytes([level])).text(name).text(message).text(hardware_id)
    body.uints(len(values))
    for key, value in values.items():
        body.text(key).text(str(value))
    return body.done()


def status_array(stamp_ns: int, frame_id: str, one: bytes) -> bytes:
    """Return a DiagnosticArray of one DiagnosticStatus."""
    return _Body(stamp_ns, frame_id).uints(1).raw(one[len(_ENCAPSULATION):]).done()


# --- reading ---

def read_point_cloud(cdr: bytes) -> PointCloud:
    """Return a PointCloud2; MessageError for other bytes."""
    try:
        header, at = _read_header(cdr)
        at = _aligned(at, 4)
        height, width = struct.unpack_from('<II', cdr, at)
        layout = _layout(cdr, at + 8)
        at = _aligned(at + 8 + len(layout.data), 4)
        step, _, size = struct.unpack_from('<III', cdr, at)
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise MessageError(f'{len(cdr)} bytes are not a cloud: {error}') from error
    data = cdr[at + 12:at + 12 + size]
    if len(data) != size:
        raise MessageError(f'cloud of {size} bytes ends after {len(data)}')
    return PointCloud(header, height, width, layout.fields, layout.is_bigendian, step, data)


class _Layout(NamedTuple):
    """The bytes from the number of fields to is_bigendian, and what they say."""

    data: bytes
    fields: tuple[PointField, ...]
    is_bigendian: bool


_layouts: dict[bytes, _Layout] = {}
"""By their first bytes: the clouds of a topic have one layout, which is parsed once."""


def _layout(cdr: bytes, begin: int) -> _Layout:
    """Return the layout that begins at a multiple of 4."""
    key = cdr[begin:begin + 48]
    known = _layouts.get(key)
    if known is not None and cdr.startswith(known.data, begin):
        return known
    at, fields = begin + 4, []
    for _ in range(_UINT.unpack_from(cdr, begin)[0]):
        size, = _UINT.unpack_from(cdr, at)
        name = cdr[at + 4:at + 3 + size].decode()
        at = _aligned(at + 4 + size, 4)
        offset, datatype = struct.unpack_from('<IB', cdr, at)
        at = _aligned(at + 5, 4)
        fields.append(PointField(name, offset, datatype))
        at += 4
    layout = _Layout(cdr[begin:at + 1], tuple(fields), bool(cdr[at]))
    if len(_layouts) < _MOST_LAYOUTS:
        _layouts[key] = layout
    return layout


def read_image(cdr: bytes) -> Image:
    """Return an Image without a copy of its pixels; MessageError for other bytes."""
    try:
        header, at = _read_header(cdr)
        at = _aligned(at, 4)
        height, width = struct.unpack_from('<II', cdr, at)
        encoding, end = _read_text(cdr, at + 8)
        at = _aligned(end + 1, 4) + 8
        step, size = struct.unpack_from('<II', cdr, at - 8)
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise MessageError(f'image message of {len(cdr)} bytes is invalid: {error}') from error
    data = memoryview(cdr)[at:at + size]
    if len(data) != size:
        raise MessageError(f'image message of {len(cdr)} bytes is too short for {size} of data')
    return Image(header, height, width, encoding, cdr[end], step, data)


def read_status(cdr: bytes) -> Status:
    """Return a DiagnosticStatus; MessageError for other bytes."""
    _check_encapsulation(cdr)
    try:
        name, at = _read_text(cdr, 5)
        message, at = _read_text(cdr, at)
        hardware_id, at = _read_text(cdr, at)
        at, values = _aligned(at, 4), []
        count, = _UINT.unpack_from(cdr, at)
        at += 4
        for _ in range(count):
            key, at = _read_text(cdr, at)
            value, at = _read_text(cdr, at)
            values.append(KeyValue(key, value))
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise MessageError(f'{len(cdr)} bytes are not status: {error}') from error
    return Status(cdr[4:5], name, message, hardware_id, tuple(values))


def _read_text(cdr: bytes, at: int) -> tuple[str, int]:
    """Return the string from a place on, and where it ends; IndexError behind the bytes."""
    at = _aligned(at, 4)
    end = at + 4 + _UINT.unpack_from(cdr, at)[0]
    if end > len(cdr):
        raise IndexError(f'a text ends at {end}')
    return cdr[at + 4:end - 1].decode(), end


def read_imu(cdr: bytes) -> Imu:
    """Return an Imu; MessageError for other bytes."""
    header, doubles = _header_and_doubles(cdr, 37, 'Imu')
    # A copy, which is aligned.
    values = doubles[:25].copy()
    return Imu(header, Quaternion(*values[:4].tolist()), values[4:13],
               Vector(*values[13:16].tolist()), values[16:25])


def read_rates(cdr: bytes) -> Rates:
    """Return header and body rate of an Imu; MessageError for other bytes."""
    header, doubles = _header_and_doubles(cdr, 37, 'Imu')
    return Rates(header, doubles[13:16], doubles[16:25])


def _header_and_doubles(cdr: bytes, count: int, kind: str) -> tuple[Header, np.ndarray]:
    """Return the header and the float64 (count,) behind it; MessageError where there are none."""
    try:
        header, at = _read_header(cdr)
        return header, np.frombuffer(cdr, '<f8', count, 4 + _aligned(at - 4, 8))
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise MessageError(f'{len(cdr)} bytes are not {kind}: {error}') from error


def read_quaternion(cdr: bytes) -> tuple[Header, Quaternion]:
    """Return header and quaternion of a QuaternionStamped; MessageError for other bytes."""
    header, doubles = _header_and_doubles(cdr, 4, 'QuaternionStamped')
    return header, Quaternion(*doubles.tolist())


def read_stamp(cdr: bytes) -> Stamp:
    """Return the stamp of a message that begins with a header, in either order of its bytes."""
    if len(cdr) < 12:
        raise MessageError(f'{len(cdr)} bytes are not a message with a header')
    return Stamp(*struct.unpack_from('<iI' if cdr[1] & 1 else '>iI', cdr, 4))


def _read_header(cdr: bytes) -> tuple[Header, int]:
    """Return the header of little-endian bytes, and where it ends."""
    _check_encapsulation(cdr)
    seconds, nanoseconds, size = struct.unpack_from('<iII', cdr, 4)
    end = 16 + size
    return Header(seconds * 1_000_000_000 + nanoseconds, cdr[16:end - 1].decode()), end


def _check_encapsulation(cdr: bytes) -> None:
    if not is_little_endian(cdr):
        raise MessageError(f'encapsulation {cdr[:4]!r} is not little-endian CDR')


def is_little_endian(cdr: bytes) -> bool:
    """Return whether bytes have the encapsulation that is read here."""
    return cdr.startswith(_ENCAPSULATION[:2])


def _aligned(at: int, size: int) -> int:
    return at + -at % size
