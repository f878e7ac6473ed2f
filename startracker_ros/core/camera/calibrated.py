# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Cameras of calibrations as ROS has them: sensor_msgs/CameraInfo and YAML of camera_calibration.

What no camera for stars can have is rejected here, before anything is built for it.
"""

from collections.abc import Sequence

import numpy as np
from startracker_ros.core.camera.distortion import MODELS, PLUMB_BOB
from startracker_ros.core.camera.model import Camera, CameraError

LARGEST_PIXEL_DEG = 0.4
"""At this size one star of the whole sky is farther than six pixels (CROWD_PX of the on-board
catalogue) from all that would blend with it; at 0.3 deg 57 are. A catalogue takes longer to build
the larger the pixels are: here 1.4 s and 130 MiB, at 1 deg 3.5 s and 500 MiB."""

MOST_PIXEL_RATIO = 4.0
"""Of the focal lengths: binning of a sensor with square pixels along one side."""

# Of the width and the height: a matrix of half the image size, or of one and a half times, has the
# principal point at 0.25 from the middle in both, to within what lenses are off the middle.
_CORNER_SHARE = 0.22


def calibrated_camera(width: int, height: int, model: str, d: Sequence[float],
                      k: Sequence[float], p: Sequence[float] = ()) -> Camera:
    """
    Return the camera of a calibration; CameraError names what cannot be right.

    d are the distortion terms in the order of OpenCV: those that are left out are zero, and those
    beyond the terms of the model (thin prism, tilted sensor) must be. k (9,) and p (12,) are
    matrices by rows. p, that of a rectified image, counts where k is all zero.
    """
    model = model or PLUMB_BOB
    if len(k) != 9:
        raise CameraError(f'K has {len(k)} numbers, not 9')
    if not any(k) and any(p):
        if any(d):
            raise CameraError('D has distortion terms but K is empty: P is that of a rectified '
                              'image, which has none')
        k = [*p[:3], *p[4:7], *p[8:11]]
    camera = Camera(width, height, k[0], k[4], k[2], k[5], _coefficients(model, d), model)
    if any((k[1], k[3], k[6], k[7])):
        raise CameraError(f'K = {list(k)} is not fx 0 cx, 0 fy cy, 0 0 1 by rows')
    check_pixels(camera)
    ratio = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if ratio > MOST_PIXEL_RATIO:
        raise CameraError(f'focal length ({camera.fx:g}, {camera.fy:g}) px: pixels of {ratio:.2g} '
                          f': 1, at most {MOST_PIXEL_RATIO:g} : 1 is possible')
    if camera.cx == camera.cy == 0 or not (-width <= camera.cx <= 2 * width
                                           and -height <= camera.cy <= 2 * height):
        raise CameraError(f'principal point ({camera.cx:g}, {camera.cy:g}) px is not set, or far '
                          f'off the image of {width} x {height} px')
    return camera


def _coefficients(model: str, d: Sequence[float]) -> tuple[float, ...]:
    """Return the coefficients of a model out of the terms d."""
    if model not in MODELS:
        return tuple(d)
    count = len(MODELS[model].coefficients)
    if any(d[count:]):
        raise CameraError(f'{model} has {count} distortion terms, got {len(d)}: those beyond '
                          '(thin prism, tilted sensor) must be zero')
    return (*d[:count], *(0.0,) * (count - len(d)))


def check_pixels(camera: Camera) -> None:
    """Raise CameraError for pixels in which no star is apart from its neighbours."""
    pixel_deg = np.degrees(camera.pixel_rad)
    if pixel_deg > LARGEST_PIXEL_DEG:
        raise CameraError(
            f'a pixel is {pixel_deg:.2g} deg wide, more than {LARGEST_PIXEL_DEG:g} resolve no '
            f'stars: focal length ({camera.fx:g}, {camera.fy:g}) px is to be that in mm / pixel '
            'size in mm')


def check_sensor(camera: Camera) -> None:
    """Raise CameraError where the image of a whole sensor cannot have the principal point."""
    off = np.abs([camera.cx / max(camera.width - 1, 1) - 0.5,
                  camera.cy / max(camera.height - 1, 1) - 0.5])
    where = ('not within' if off.max() >= 0.5 else 'in a corner of' if off.min() > _CORNER_SHARE
             else '')
    if where:
        raise CameraError(
            f'principal point ({camera.cx:g}, {camera.cy:g}) px is {where} the image of '
            f'{camera.width} x {camera.height} px: K is of another image size, or the image is a '
            'part of that of the sensor and roi is not set')
