# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Layouts of messages, free of ROS: fields of the clouds, stamps, pixels and camera_info.

They serve the nodes, whose messages rclpy makes, and readers of bags, whose messages come from
other decoders: every function here reads attributes only.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from startracker_ros.core.camera.calibrated import (
    calibrated_camera, check_pixels, check_sensor)
from startracker_ros.core.camera.model import Camera, CameraError

_CENTROID_FIELDS = [(name, 'f4') for name in ('x', 'y', 'z', 'u', 'v', 'flux', 'snr', 'sigma_px')]
_STAR_FIELDS = [*_CENTROID_FIELDS, ('hip', 'u4'), ('magnitude', 'f4'), ('residual_px', 'f4')]
# Zero in clouds that do not have them, such as those of older recordings.
_MEASUREMENT_FIELDS = [('cov_uu', 'f4'), ('cov_uv', 'f4'), ('cov_vv', 'f4'),
                       ('stamp_offset', 'f4'), ('common_uu', 'f4'), ('common_uv', 'f4'),
                       ('common_vv', 'f4'), ('directed', 'u1'), ('exposure_min', 'f4'),
                       ('exposure_max', 'f4')]
_TRACK_FIELDS = [
    *_STAR_FIELDS, ('track_id', 'u4'), ('age', 'u2'), ('missed', 'u1'),
    ('association_probability', 'f4'), ('u_rate', 'f4'), ('v_rate', 'f4'),
    ('cov_uu', 'f4'), ('cov_uv', 'f4'), ('cov_vv', 'f4')]

# Aligned as a C struct, so that viewers, and _never_nan(), find each float, of 4 bytes, in place.
CENTROID_DTYPE = np.dtype(_CENTROID_FIELDS + _MEASUREMENT_FIELDS, align=True)
STAR_DTYPE = np.dtype(_STAR_FIELDS + _MEASUREMENT_FIELDS, align=True)
TRACK_DTYPE = np.dtype(_TRACK_FIELDS, align=True)
PREDICTION_DTYPE = np.dtype([
    ('u', 'f4'), ('v', 'f4'), ('sigma', 'f4'), ('hip', 'u4'), ('u_rate', 'f4'),
    ('v_rate', 'f4'), ('body', 'u1')], align=True)
TARGET_BODY = 10
"""`body` of a target in a cloud of predicted centroids."""

_OPTIONAL = {CENTROID_DTYPE: _MEASUREMENT_FIELDS, STAR_DTYPE: _MEASUREMENT_FIELDS,
             PREDICTION_DTYPE: [('body', 'u1')]}

SENSOR_FRAME_ID = 'star_tracker_optical_frame'
"""Optical frame of a camera that has no name for it: images with an empty frame_id."""

# By the numbers of sensor_msgs/PointField.
_NUMPY_TYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
POINT_FIELD_TYPES = {name: number for number, name in _NUMPY_TYPES.items()}
# Fields in which NaN has a meaning: outside the image circle, not identified, not observed in this
# frame.
_MAY_BE_NAN = {'x', 'y', 'z', 'magnitude', 'residual_px', 'flux', 'snr', 'sigma_px'}


class MessageError(ValueError):
    """A message that its topic does not allow; the text names the field."""


def ns_from_stamp(stamp: Any) -> int:
    """Return integer nanoseconds of a message stamp."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def image_from_message(message: Any) -> np.ndarray:
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


def sensor_from_message(message: Any) -> Camera:
    """Return the camera of a CameraInfo with the whole sensor; CameraError names what is wrong."""
    return _sensor(message.width, message.height, message.distortion_model, tuple(message.d),
                   tuple(map(float, message.k)), tuple(map(float, message.p)))


def camera_from_message(message: Any) -> Camera:
    """
    Return the camera of the images of a CameraInfo; CameraError names what is wrong.

    Width, height, K and P are those of the whole sensor: roi and binning_x, binning_y are applied
    as image_geometry does. R is not read: the axes are those of the image.
    """
    roi = message.roi
    return _part(sensor_from_message(message),
                 (roi.x_offset, roi.y_offset, roi.width, roi.height),
                 (message.binning_x or 1, message.binning_y or 1))


# A camera comes with every image: it is checked once.
@lru_cache
def _sensor(width: int, height: int, model: str, d: tuple[float, ...], k: tuple[float, ...],
            p: tuple[float, ...]) -> Camera:
    camera = calibrated_camera(width, height, model, d, k, p)
    check_sensor(camera)
    return camera


@lru_cache
def _part(sensor: Camera, roi: tuple[int, int, int, int], binning: tuple[int, int]) -> Camera:
    """Return the camera of a part of the image of a sensor, of all where roi is all zero."""
    x_px, y_px, width, height = roi if any(roi) else (0, 0, sensor.width, sensor.height)
    if not (0 < width <= sensor.width - x_px and 0 < height <= sensor.height - y_px):
        raise CameraError(
            f'roi of {width} x {height} px at ({x_px}, {y_px}) is not in the image of '
            f'{sensor.width} x {sensor.height} px: width, height and K are to be those of the '
            'whole sensor')
    if not (binning[0] <= width and binning[1] <= height):
        raise CameraError(f'binning of {binning[0]} x {binning[1]} px leaves no pixel of '
                          f'{width} x {height} px')
    camera = sensor.cropped(x_px, y_px, width, height).binned(*binning)
    check_pixels(camera)
    return camera


def protection_from_message(message: Any) -> np.ndarray:
    """Return the bound (3,) of a `protection_level`; MessageError where it is none."""
    bound = np.array([message.vector.x, message.vector.y, message.vector.z])
    if not (bound > 0).all():
        raise MessageError(f'protection level {bound.tolist()} is no bound')
    return bound


def read_cloud(message: Any, wanted: np.dtype) -> np.ndarray:
    """Return the rows (N,) of a cloud in the wanted layout; MessageError names the field."""
    count = message.width * message.height
    if message.is_bigendian:
        raise MessageError('big-endian point clouds are not supported')
    if len(message.data) < count * message.point_step:
        raise MessageError(f'cloud data of {len(message.data)} bytes is too short for '
                           f'{count} points of {message.point_step} bytes')
    fields = message.fields
    if not isinstance(fields, tuple):
        # Messages of rclpy and of other decoders: their fields have no hash.
        fields = tuple((f.name, f.offset, f.datatype) for f in fields)
    layout = _layout(fields, message.point_step, wanted)
    read = np.frombuffer(message.data, layout, count)
    if layout is wanted:
        rows = read.copy()
    elif layout.names == wanted.names:
        # From structure to structure NumPy copies by position, the order of the names.
        rows = read.astype(wanted)
    else:
        rows = np.zeros(count, wanted)
        for name in layout.names or ():
            rows[name] = read[name]
    values = rows.view('f4').reshape(count, wanted.itemsize // 4)
    # Most clouds are finite in all fields, those of integers read as floats included.
    if not np.isfinite(values).all():
        names, columns = _never_nan(wanted)
        finite = np.isfinite(values[:, columns])
        if not finite.all():
            point, column = np.argwhere(~finite)[0]
            raise MessageError(f'cloud field {names[column]!r} is not finite in point {point}')
    return rows


@lru_cache
def _layout(fields: tuple[tuple[str, int, int], ...], point_step: int, wanted: np.dtype
            ) -> np.dtype:
    """Return where the wanted fields stand among those offered, (name, offset, datatype)."""
    offered = {name: (offset, datatype) for name, offset, datatype in fields}
    optional = {name for name, _ in _OPTIONAL.get(wanted, ())}
    names = [name for name in wanted.names or () if name in offered or name not in optional]
    for name in names:
        if name not in offered:
            raise MessageError(f'cloud has no field {name!r}; it has {sorted(offered)}')
        offset, datatype = offered[name]
        if _NUMPY_TYPES.get(datatype) != wanted[name].str[1:]:
            raise MessageError(f'cloud field {name!r} has datatype {datatype}, '
                               f'must be {POINT_FIELD_TYPES[wanted[name].str[1:]]}')
        if offset + wanted[name].itemsize > point_step:
            raise MessageError(f'cloud field {name!r} lies outside the point')
    layout = np.dtype({'names': names, 'formats': [wanted[name] for name in names],
                       'offsets': [offered[name][0] for name in names], 'itemsize': point_step})
    return wanted if layout == wanted else layout


@lru_cache
def _never_nan(wanted: np.dtype) -> tuple[list[str], list[int]]:
    """Return the float fields that must be finite, and their columns in rows viewed as floats."""
    columns = {name: offset // 4 for name, (dtype, offset, *_) in (wanted.fields or {}).items()
               if dtype.kind == 'f' and name not in _MAY_BE_NAN}
    return list(columns), list(columns.values())


def rotation_covariance(covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (6, 6) of a pose or twist, of its rotation (3, 3) alone."""
    whole = np.zeros((6, 6))
    whole[3:, 3:] = covariance
    return whole
