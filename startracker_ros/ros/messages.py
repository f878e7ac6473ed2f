"""NumPy and stage results to ROS messages and back: every layout stands here once."""

from functools import lru_cache
import struct
import sys
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    PoseWithCovarianceStamped, Quaternion, QuaternionStamped, TransformStamped, Vector3)
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2, PointField
from startracker_ros.attitude.result import AttitudeEstimate, covariance_icrf
from startracker_ros.camera import Camera, CameraError
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.locate.state import State
from startracker_ros.ros.message_types import MessageError
from startracker_ros.rotation import conjugate, matrix_from_quaternion, rotate
from startracker_ros.track.tracks import TrackedAttitude, Tracks
from std_msgs.msg import Header

if TYPE_CHECKING:
    from startracker_ros.identify.identification import Identification
    from startracker_ros.locate.location import Location

_CENTROID_FIELDS = [(name, 'f4') for name in ('x', 'y', 'z', 'u', 'v', 'flux', 'snr', 'sigma_px')]
_STAR_FIELDS = [*_CENTROID_FIELDS, ('hip', 'u4'), ('magnitude', 'f4'), ('residual_px', 'f4')]
_TRACK_FIELDS = [
    *_STAR_FIELDS, ('track_id', 'u4'), ('age', 'u2'), ('missed', 'u1'),
    ('association_probability', 'f4'), ('u_rate', 'f4'), ('v_rate', 'f4'),
    ('cov_uu', 'f4'), ('cov_uv', 'f4'), ('cov_vv', 'f4')]

# Aligned as a C struct, so that viewers, and _never_nan(), find each float, of 4 bytes, in place.
CENTROID_DTYPE = np.dtype(_CENTROID_FIELDS, align=True)
STAR_DTYPE = np.dtype(_STAR_FIELDS, align=True)
TRACK_DTYPE = np.dtype(_TRACK_FIELDS, align=True)

_POINT_FIELD_TYPES = {
    'i1': PointField.INT8, 'u1': PointField.UINT8, 'i2': PointField.INT16,
    'u2': PointField.UINT16, 'i4': PointField.INT32, 'u4': PointField.UINT32,
    'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64}
_NUMPY_TYPES = {number: name for name, number in _POINT_FIELD_TYPES.items()}
# A camera comes with every image: checked once, and what follows from it computed once.
_camera = lru_cache(Camera)
_CDR_LITTLE_ENDIAN = b'\x00\x01'
# Fields that may be NaN by their meaning: not identified, not observed in this frame.
_MAY_BE_NAN = {'magnitude', 'residual_px', 'flux', 'snr', 'sigma_px'}


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a message stamp of integer nanoseconds since the UNIX epoch."""
    return Time(sec=int(stamp_ns // 1_000_000_000), nanosec=int(stamp_ns % 1_000_000_000))


def ns_from_stamp(stamp: Time) -> int:
    """Return integer nanoseconds of a message stamp."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """Return a header of integer nanoseconds and a frame."""
    return Header(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)


def image_to_message(image: np.ndarray, header: Header) -> Image:
    """
    Return mono8, mono16 or rgb8 of (H, W) uint8 or uint16 or (H, W, 3) uint8.

    The message shows the image itself: whoever changes that changes both.
    """
    image = np.ascontiguousarray(image)
    encoding = {(2, 1): 'mono8', (2, 2): 'mono16', (3, 1): 'rgb8'}[image.ndim, image.itemsize]
    message = Image(header=header, height=image.shape[0], width=image.shape[1],
                    encoding=encoding, is_bigendian=sys.byteorder == 'big',
                    step=image.strides[0])
    # The property would copy into an array.array; what makes DDS samples of messages takes any
    # buffer, and so does image_from_message().
    message._data = image.data.cast('B')
    return message


def image_from_message(message: Image) -> np.ndarray:
    """Return a (H, W) uint8 or uint16 view of mono8 or mono16; MessageError if it is neither."""
    kinds = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2'}
    if message.encoding not in kinds:
        raise MessageError(f'image encoding {message.encoding!r} is not mono8 or mono16')
    if message.width == 0 or message.height == 0:
        raise MessageError(f'image size {message.width} x {message.height} is empty')
    order = '>' if message.is_bigendian else '<'
    dtype = np.dtype(order + kinds[message.encoding])
    row_bytes = message.width * dtype.itemsize
    if message.step < row_bytes or len(message.data) < message.step * message.height:
        raise MessageError(
            f'image data of {len(message.data)} bytes, step {message.step}, is too short for '
            f'{message.width} x {message.height} {message.encoding}')
    image = np.ndarray((message.height, message.width), dtype, message.data,
                       strides=(message.step, dtype.itemsize))
    return image if dtype.isnative else image.astype(dtype.newbyteorder('='))


def image_message_from_cdr(data: bytes) -> Image:
    """
    Return a serialized image, whose data shows the bytes; MessageError if it is none.

    rclpy would copy the data three times. CDR as in OMG DDSI-RTPS 10.2, little-endian; other
    encodings are rclpy's.
    """
    if not data.startswith(_CDR_LITTLE_ENDIAN):
        return deserialize_message(data, Image)
    try:
        sec, nanosec = struct.unpack_from('<iI', data, 4)
        frame_id, end = _cdr_string(data, 12)
        height, width = struct.unpack_from('<II', data, _aligned(end))
        encoding, end = _cdr_string(data, _aligned(end) + 8)
        big_endian = data[end]
        step, count = struct.unpack_from('<II', data, _aligned(end + 1))
    except (struct.error, IndexError) as error:
        raise MessageError(f'image message of {len(data)} bytes ends too early') from error
    begin = _aligned(end + 1) + 8
    if begin + count > len(data):
        raise MessageError(f'image message of {len(data)} bytes is too short for {count} of data')
    message = Image(header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id),
                    height=height, width=width, encoding=encoding, is_bigendian=big_endian,
                    step=step)
    message._data = memoryview(data)[begin:begin + count]
    return message


def _aligned(place: int) -> int:
    """Return where the next number of four bytes begins; the encapsulation has four itself."""
    return -(-place // 4) * 4


def _cdr_string(data: bytes, place: int) -> tuple[str, int]:
    """Return a string, with its length and a zero at the end, and the place behind it."""
    begin = place + 4
    end = begin + struct.unpack_from('<I', data, place)[0]
    if end > len(data):
        raise IndexError(end)
    return data[begin:end].rstrip(b'\0').decode(errors='replace'), end


def camera_to_message(camera: Camera, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    return CameraInfo(
        header=header, width=camera.width, height=camera.height, distortion_model='plumb_bob',
        d=list(camera.distortion), k=k, r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0])


def camera_from_message(message: CameraInfo) -> Camera:
    """Return the camera of a CameraInfo; CameraError names what is wrong."""
    if message.distortion_model not in ('', 'plumb_bob'):
        raise CameraError(f'distortion_model {message.distortion_model!r} is not plumb_bob')
    # An empty D is what drivers send for an ideal lens; four terms leave k3 out.
    distortion = tuple(message.d) + (0.0,) * (5 - len(message.d))
    fx, _, cx, _, fy, cy = map(float, message.k[:6])
    return _camera(message.width, message.height, fx, fy, cx, cy, distortion)


def _cloud(rows: np.ndarray, header: Header) -> PointCloud2:
    fields = [PointField(name=name, offset=offset, count=1,
                         datatype=_POINT_FIELD_TYPES[dtype.str[1:]])
              for name, (dtype, offset, *_) in (rows.dtype.fields or {}).items()]
    message = PointCloud2(header=header, height=1, width=len(rows), fields=fields,
                          is_bigendian=False, point_step=rows.dtype.itemsize,
                          row_step=rows.nbytes, is_dense=True)
    if len(rows):
        message.data.frombytes(rows.tobytes())
    return message


@lru_cache
def _layout(fields: tuple[tuple[str, int, int], ...], point_step: int, wanted: np.dtype
            ) -> np.dtype:
    """Return where the wanted fields stand among those offered, (name, offset, datatype)."""
    offered = {name: (offset, datatype) for name, offset, datatype in fields}
    names = wanted.names or ()
    for name in names:
        if name not in offered:
            raise MessageError(f'cloud has no field {name!r}; it has {sorted(offered)}')
        offset, datatype = offered[name]
        if _NUMPY_TYPES.get(datatype) != wanted[name].str[1:]:
            raise MessageError(f'cloud field {name!r} has datatype {datatype}, '
                               f'must be {_POINT_FIELD_TYPES[wanted[name].str[1:]]}')
        if offset + wanted[name].itemsize > point_step:
            raise MessageError(f'cloud field {name!r} lies outside the point')
    return np.dtype({'names': names, 'formats': [wanted[name] for name in names],
                     'offsets': [offered[name][0] for name in names], 'itemsize': point_step})


@lru_cache
def _never_nan(wanted: np.dtype) -> tuple[list[str], list[int]]:
    """Return the float fields that must be finite, and where they stand in rows seen as floats."""
    places = {name: offset // 4 for name, (dtype, offset, *_) in (wanted.fields or {}).items()
              if dtype.kind == 'f' and name not in _MAY_BE_NAN}
    return list(places), list(places.values())


def read_cloud(message: PointCloud2, wanted: np.dtype) -> np.ndarray:
    """Return the rows (N,) of a cloud in the wanted layout; MessageError names the field."""
    count = message.width * message.height
    if message.is_bigendian:
        raise MessageError('big-endian point clouds are not supported')
    if len(message.data) < count * message.point_step:
        raise MessageError(f'cloud data of {len(message.data)} bytes is too short for '
                           f'{count} points of {message.point_step} bytes')
    layout = _layout(tuple((f.name, f.offset, f.datatype) for f in message.fields),
                     message.point_step, wanted)
    # From structure to structure NumPy copies by position, and that is the order of the names.
    rows = np.frombuffer(message.data, layout, count).astype(wanted)
    names, columns = _never_nan(wanted)
    finite = np.isfinite(rows.view('f4').reshape(count, wanted.itemsize // 4)[:, columns])
    if not finite.all():
        point, column = np.argwhere(~finite)[0]
        raise MessageError(f'cloud field {names[column]!r} is not finite in point {point}')
    return rows


def _centroid_rows(dtype: np.dtype, uv: np.ndarray, flux: np.ndarray, snr: np.ndarray,
                   sigma_px: np.ndarray, camera: Camera) -> np.ndarray:
    rows = np.zeros(len(uv), dtype)
    directions = camera.unproject(uv)
    for column, name in enumerate('xyz'):
        rows[name] = directions[:, column]
    rows['u'], rows['v'] = uv[:, 0], uv[:, 1]
    rows['flux'], rows['snr'], rows['sigma_px'] = flux, snr, sigma_px
    return rows


def centroids_to_message(centroids: Centroids, camera: Camera, header: Header) -> PointCloud2:
    """Return the `centroids` cloud."""
    return _cloud(_centroid_rows(CENTROID_DTYPE, centroids.uv, centroids.flux, centroids.snr,
                                 centroids.sigma_px, camera), header)


def centroids_from_rows(rows: np.ndarray) -> Centroids:
    """Return the centroids of `centroids` or `stars` rows."""
    return Centroids(
        uv=np.stack([rows['u'], rows['v']], -1).astype(float), flux=rows['flux'].astype(float),
        snr=rows['snr'].astype(float), sigma_px=rows['sigma_px'].astype(float))


def centroids_from_message(message: PointCloud2) -> Centroids:
    """Return the centroids of a `centroids` cloud."""
    return centroids_from_rows(read_cloud(message, CENTROID_DTYPE))


def stars_to_message(centroids: Centroids, hip: np.ndarray, magnitude: np.ndarray,
                     residual_px: np.ndarray, camera: Camera, header: Header) -> PointCloud2:
    """Return the `stars` cloud of centroids with a catalogue number each, 0 for none."""
    rows = _centroid_rows(STAR_DTYPE, centroids.uv, centroids.flux, centroids.snr,
                          centroids.sigma_px, camera)
    rows['hip'], rows['magnitude'], rows['residual_px'] = hip, magnitude, residual_px
    return _cloud(rows, header)


def identification_to_message(centroids: Centroids, identification: 'Identification',
                              camera: Camera, header: Header) -> PointCloud2:
    """Return the `stars` cloud of an identified frame."""
    return stars_to_message(centroids, identification.hip, identification.magnitude,
                            identification.residual_px, camera, header)


def tracks_to_message(tracks: Tracks, camera: Camera, header: Header) -> PointCloud2:
    """Return the `tracks` cloud."""
    rows = _centroid_rows(TRACK_DTYPE, tracks.uv, tracks.flux, tracks.snr, tracks.sigma_px,
                          camera)
    for name in ('hip', 'magnitude', 'residual_px', 'track_id', 'age', 'missed',
                 'association_probability'):
        rows[name] = getattr(tracks, name)
    rows['u_rate'], rows['v_rate'] = tracks.velocity.T
    rows['cov_uu'], rows['cov_vv'] = tracks.covariance[:, 0, 0], tracks.covariance[:, 1, 1]
    rows['cov_uv'] = tracks.covariance[:, 0, 1]
    return _cloud(rows, header)


def tracks_from_message(message: PointCloud2) -> Tracks:
    """Return the tracks of a `tracks` cloud."""
    rows = read_cloud(message, TRACK_DTYPE)
    covariance = np.stack([rows['cov_uu'], rows['cov_uv'], rows['cov_uv'], rows['cov_vv']], -1)
    columns = {name: rows[name].astype(float) for name in (
        'magnitude', 'flux', 'snr', 'sigma_px', 'residual_px', 'association_probability')}
    return Tracks(
        hip=rows['hip'].astype(np.int32),
        uv=np.stack([rows['u'], rows['v']], -1).astype(float),
        velocity=np.stack([rows['u_rate'], rows['v_rate']], -1).astype(float),
        covariance=covariance.reshape(-1, 2, 2).astype(float),
        track_id=rows['track_id'], age=rows['age'], missed=rows['missed'], **columns)


def _quaternion(quaternion: np.ndarray) -> Quaternion:
    x, y, z, w = map(float, quaternion)
    return Quaternion(x=x, y=y, z=z, w=w)


def _vector(vector: np.ndarray) -> Vector3:
    x, y, z = map(float, vector)
    return Vector3(x=x, y=y, z=z)


def quaternion_to_message(quaternion: np.ndarray, header: Header) -> QuaternionStamped:
    """Return `attitude` or `truth/attitude` of q_icrf_from_sensor (4,)."""
    return QuaternionStamped(header=header, quaternion=_quaternion(quaternion))


def quaternion_from_message(message: QuaternionStamped) -> np.ndarray:
    """Return q_icrf_from_sensor (4,)."""
    q = message.quaternion
    return np.array([q.x, q.y, q.z, q.w])


def attitude_to_pose(attitude: AttitudeEstimate, header: Header) -> PoseWithCovarianceStamped:
    """Return `attitude_cov`: position zero, the rotation block about ICRF axes in rad^2."""
    message = PoseWithCovarianceStamped(header=header)
    message.pose.pose.orientation = _quaternion(attitude.quaternion)
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = covariance_icrf(attitude.quaternion, attitude.covariance_sensor)
    message.pose.covariance = covariance.ravel()
    return message


def attitude_to_imu(attitude: AttitudeEstimate | None, header: Header) -> Imu:
    """
    Return `attitude_imu`; without an attitude the covariance is -1 and the quaternion zero.

    A quaternion of zeros is no rotation, so that a reader who forgets to look at the
    covariance cannot take it for one.
    """
    message = Imu(header=header)
    message.angular_velocity_covariance[0] = -1.0
    message.linear_acceleration_covariance[0] = -1.0
    if attitude is None:
        message.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
        message.orientation_covariance[0] = -1.0
    else:
        message.orientation = _quaternion(attitude.quaternion)
        message.orientation_covariance = covariance_icrf(
            attitude.quaternion, attitude.covariance_sensor).ravel()
    return message


def tracked_attitude_to_imu(tracked: TrackedAttitude | None, header: Header) -> Imu:
    """Return `tracked_attitude` or `attitude_imu` with the body rate on sensor axes."""
    if tracked is None:
        return attitude_to_imu(None, header)
    message = attitude_to_imu(tracked.attitude, header)
    message.angular_velocity = _vector(tracked.rate_rad_s)
    message.angular_velocity_covariance = tracked.rate_covariance.ravel()
    return message


def tracked_attitude_from_imu(message: Imu) -> TrackedAttitude | None:
    """Return what `tracked_attitude` says, None where it has no attitude; without its stars."""
    if message.orientation_covariance[0] == -1:
        return None
    q, rate = message.orientation, message.angular_velocity
    quaternion = np.array([q.x, q.y, q.z, q.w])
    covariance_about_icrf = np.reshape(message.orientation_covariance, (3, 3))
    if not (np.isfinite(covariance_about_icrf).all()
            and abs(np.linalg.norm(quaternion) - 1) < 1e-6):
        raise MessageError(f'orientation {quaternion.tolist()} with covariance '
                           f'{covariance_about_icrf.tolist()} is no attitude')
    matrix = matrix_from_quaternion(quaternion)
    return TrackedAttitude(
        AttitudeEstimate(quaternion, matrix.T @ covariance_about_icrf @ matrix, 0, np.empty(0),
                         np.nan),
        np.array([rate.x, rate.y, rate.z]),
        np.reshape(message.angular_velocity_covariance, (3, 3)))


def attitude_to_transform(attitude: AttitudeEstimate, header: Header,
                          sensor_frame_id: str) -> TransformStamped:
    """Return `attitude_transform`, inertial to sensor frame, no translation."""
    message = TransformStamped(header=header, child_frame_id=sensor_frame_id)
    message.transform.rotation = _quaternion(attitude.quaternion)
    return message


def gyro_to_imu(rate_rad_s: np.ndarray, sigma_rad_s: float, header: Header) -> Imu:
    """Return `imu` of a gyro (3,) in the sensor frame: no orientation, no acceleration."""
    message = Imu(header=header, angular_velocity=_vector(rate_rad_s))
    message.orientation_covariance[0] = -1.0
    message.linear_acceleration_covariance[0] = -1.0
    message.angular_velocity_covariance = (np.eye(3) * sigma_rad_s ** 2).ravel()
    return message


def rate_from_imu(message: Imu) -> np.ndarray:
    """Return the rate (3,) in rad/s of `imu`; MessageError when it says that it has none."""
    if message.angular_velocity_covariance[0] == -1:
        raise MessageError('angular_velocity_covariance[0] is -1: imu has no angular velocity')
    rate = message.angular_velocity
    return np.array([rate.x, rate.y, rate.z])


def motion_to_odometry(position_m: np.ndarray, velocity_m_s: np.ndarray, quaternion: np.ndarray,
                       rate_rad_s: np.ndarray, header: Header,
                       sensor_frame_id: str) -> Odometry:
    """
    Return `truth/odometry`: pose in the inertial frame, twist in the sensor frame.

    nav_msgs/Odometry has its twist in child_frame_id, so the ICRF velocity is turned
    into the sensor frame.
    """
    message = Odometry(header=header, child_frame_id=sensor_frame_id)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, position_m)
    message.pose.pose.orientation = _quaternion(quaternion)
    message.twist.twist.linear = _vector(rotate(conjugate(quaternion), velocity_m_s))
    message.twist.twist.angular = _vector(rate_rad_s)
    return message


def state_from_odometry(message: Odometry, inertial_frame_id: str) -> State:
    """
    Return position and velocity on inertial axes; MessageError names what is wrong.

    The twist is in child_frame_id: turned by the orientation, unless that is the inertial
    frame itself.
    """
    if message.header.frame_id != inertial_frame_id:
        raise MessageError(f'frame {message.header.frame_id!r} is not {inertial_frame_id!r}')
    position, twist = message.pose.pose.position, message.twist.twist.linear
    velocity_m_s = np.array([twist.x, twist.y, twist.z])
    if not np.any(velocity_m_s):
        raise MessageError('twist without a velocity')
    if message.child_frame_id != inertial_frame_id:
        velocity_m_s = rotate(_unit_quaternion(message.pose.pose.orientation), velocity_m_s)
    state = State(np.array([position.x, position.y, position.z]), velocity_m_s,
                  np.reshape(message.pose.covariance, (6, 6))[:3, :3])
    if not all(np.isfinite(part).all() for part in state):
        raise MessageError('position, velocity or their covariance is not finite')
    return state


def state_to_odometry(state: State, velocity_variance: float, header: Header) -> Odometry:
    """Return `odometry` or `truth/target`: all on inertial axes, no orientation."""
    message = Odometry(header=header, child_frame_id=header.frame_id)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, state.position_m)
    message.twist.twist.linear = _vector(state.velocity_m_s)
    pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
    pose[:3, :3], twist[:3, :3] = state.covariance_m2, velocity_variance * np.eye(3)
    message.pose.covariance, message.twist.covariance = pose.ravel(), twist.ravel()
    return message


def attitude_from_pose(message: PoseWithCovarianceStamped, inertial_frame_id: str
                       ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q_icrf_from_sensor (4,) and its covariance (3, 3) about ICRF axes.

    MessageError where that is no attitude.
    """
    if message.header.frame_id != inertial_frame_id:
        raise MessageError(f'frame {message.header.frame_id!r} is not {inertial_frame_id!r}')
    covariance = np.reshape(message.pose.covariance, (6, 6))[3:, 3:]
    if not (np.isfinite(covariance).all() and (np.diag(covariance) > 0).all()):
        raise MessageError(f'rotation covariance of diagonal {np.diag(covariance).tolist()} '
                           'is not positive')
    return _unit_quaternion(message.pose.pose.orientation), covariance


def _unit_quaternion(q: Quaternion) -> np.ndarray:
    quaternion = np.array([q.x, q.y, q.z, q.w])
    if not abs(np.linalg.norm(quaternion) - 1) < 1e-6:
        raise MessageError(f'orientation {quaternion.tolist()} is no attitude')
    return quaternion


def location_to_pose(location: 'Location', header: Header) -> PoseWithCovarianceStamped:
    """Return `target/position`: position filled, no rotation and no rotation block."""
    message = PoseWithCovarianceStamped(header=header)
    position = message.pose.pose.position
    position.x, position.y, position.z = map(float, location.position_m)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = location.covariance_m2
    message.pose.covariance = covariance.ravel()
    return message
