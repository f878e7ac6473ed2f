# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Layouts of messages, free of ROS: fields of the clouds, stamps, pixels and camera_info.

They serve the nodes, whose messages rclpy makes, and readers of bags, whose messages come from
other decoders: every function here reads attributes only.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.camera.calibrated import (
    calibrated_camera, check_pixels, check_sensor)
from startracker_ros.core.camera.levels import (
    CELL_PX, colour_levels, has_swapped_bytes, mosaic_levels)
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

INERTIAL_FRAME_ID = 'icrf'
"""Frame of attitudes, odometry and targets: ICRF axes."""

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


class StarImage(NamedTuple):
    """
    The grey pixels (H, W) uint8 or uint16 of an image.

    Each is the sum or the mean of cell x cell pixels of the camera.
    """

    pixels: np.ndarray
    cell: int = 1

    def check_size(self, camera: Camera) -> None:
        """Raise MessageError for an image of another size than that of the camera."""
        height, width = self.pixels.shape
        if (height, width) != (camera.height // self.cell, camera.width // self.cell):
            raise MessageError(
                f'image of {self.cell * width} x {self.cell * height} px does not fit camera_info '
                f'of {camera.width} x {camera.height} px, its roi and binning applied')

    def in_full(self) -> np.ndarray:
        """Return the pixels as large as they are in the image of the camera."""
        if self.cell == 1:
            return self.pixels
        return self.pixels.repeat(self.cell, axis=0).repeat(self.cell, axis=1)


def image_from_message(message: Any) -> StarImage:
    """
    Return the grey pixels of an image, a view where that is possible; MessageError names a fault.

    Colours and the cells of a Bayer mosaic are joined, of YUV 4:2:2 the luminance is taken.
    """
    if message.encoding not in _ENCODINGS:
        raise MessageError(f'image encoding {message.encoding!r} is not one of '
                           f'{", ".join(_ENCODINGS)}')
    dtype, channels, grey = _ENCODINGS[message.encoding]
    if message.width == 0 or message.height == 0:
        raise MessageError(f'image size {message.width} x {message.height} is empty')
    dtype = dtype.newbyteorder('>' if message.is_bigendian else '<')
    pixel_bytes = channels * dtype.itemsize
    if (message.step < message.width * pixel_bytes
            or len(message.data) < message.step * message.height):
        raise MessageError(
            f'image data of {len(message.data)} bytes, step {message.step}, is too short for '
            f'{message.width} x {message.height} {message.encoding}')
    image = np.ndarray((message.height, message.width, channels), dtype, message.data,
                       strides=(message.step, pixel_bytes, dtype.itemsize))
    if not (dtype.isnative and image.flags.aligned):
        image = image.astype(dtype.newbyteorder('='))
    if dtype.itemsize == 2 and has_swapped_bytes(image[..., 0]):
        raise MessageError(
            'the bytes of each value are swapped, as the noise of neighbouring values says: let '
            f'the driver set is_bigendian to {int(not message.is_bigendian)}, or send the other '
            'order of bytes')
    return grey(image)


def _first(image: np.ndarray) -> StarImage:
    return StarImage(image[..., 0])


def _second(image: np.ndarray) -> StarImage:
    return StarImage(image[..., 1])


def _colours(image: np.ndarray) -> StarImage:
    return StarImage(colour_levels(image[..., :3]))


def _mosaic(image: np.ndarray) -> StarImage:
    return StarImage(mosaic_levels(image[..., 0]), CELL_PX)


_8_BIT, _16_BIT = np.dtype(np.uint8), np.dtype(np.uint16)
_ENCODINGS: dict[str, tuple[np.dtype, int, Callable[[np.ndarray], StarImage]]] = {
    'mono8': (_8_BIT, 1, _first), 'mono16': (_16_BIT, 1, _first),
    '8UC1': (_8_BIT, 1, _first), '16UC1': (_16_BIT, 1, _first),
    'rgb8': (_8_BIT, 3, _colours), 'bgr8': (_8_BIT, 3, _colours),
    'rgba8': (_8_BIT, 4, _colours), 'bgra8': (_8_BIT, 4, _colours),
    **{f'bayer_{order}{bits}': (dtype, 1, _mosaic) for bits, dtype in ((8, _8_BIT), (16, _16_BIT))
       for order in ('rggb', 'bggr', 'gbrg', 'grbg')},
    'yuv422': (_8_BIT, 2, _second), 'uyvy': (_8_BIT, 2, _second),
    'yuv422_yuy2': (_8_BIT, 2, _first), 'yuyv': (_8_BIT, 2, _first)}
"""Type and channels of a pixel, and what it is as a grey one; sensor_msgs/image_encodings.hpp."""


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
    """Return the bound (3,) of a `protection_level`; MessageError for other values."""
    bound = np.array([message.vector.x, message.vector.y, message.vector.z])
    if not (bound > 0).all():
        raise MessageError(f'protection level {bound.tolist()} is not a bound')
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
