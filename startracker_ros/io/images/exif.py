# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a camera writes in addition to its pixels: orientation, focal length, time (EXIF 2.32)."""

from datetime import datetime, UTC
import io
from typing import Any, NamedTuple
import warnings

import numpy as np
from PIL import Image

_ORIENTATION, _SUBFOLDER = 0x0112, 0x8769
_FOCAL_LENGTH, _EQUIVALENT = 0x920a, 0xa405
_PLANE_RESOLUTION, _PLANE_UNIT = 0xa20e, 0xa210
_PIXELS = 0xa002
_TIME_ORIGINAL, _OFFSET_ORIGINAL = 0x9003, 0x9011
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_FULL_FRAME_DIAGONAL_MM = 43.27
_FIELDS_DEG = (0.1, 160.0)
# Chunks of a PNG that have EXIF: of PNG 1.5, and of ImageMagick.
_PNG, _PNG_EXIF = b'\x89PNG', (b'eXIf', b'Raw profile type exif')


class Taken(NamedTuple):
    """UNIX time in ns at which an image was taken; zone_known False: UTC is assumed."""

    stamp_ns: int
    zone_known: bool
    source: str = 'EXIF'


class Exif(NamedTuple):
    """Orientation 1 to 8, field of view of the long side in deg and time, None if unknown."""

    orientation: int
    fov_deg: float | None
    taken: Taken | None


def read_exif(content: bytes, size: tuple[int, int] | None = None) -> Exif:
    """
    Return what an image file says; the defaults where it says nothing or nonsense.

    size is the width and height in px where Pillow sees only the preview of a RAW file.
    """
    # Pillow decodes all pixels of a PNG to look behind them.
    if content.startswith(_PNG) and not any(chunk in content for chunk in _PNG_EXIF):
        return Exif(1, None, None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            with Image.open(io.BytesIO(content)) as image:
                size, tags = size or image.size, image.getexif()
                orientation, details = tags.get(_ORIENTATION, 1), tags.get_ifd(_SUBFOLDER)
        return Exif(orientation if orientation in range(1, 9) else 1, _fov_deg(details, size),
                    _taken(details))
    # Pillow raises errors of many types for damaged files; OpenCV names them.
    except Exception:  # noqa: B902
        return Exif(1, None, None)


def _fov_deg(details: dict[int, Any], size: tuple[int, int]) -> float | None:
    """Return the field of view of the long side, by the equivalent focal length or the sensor."""
    equivalent = float(details.get(_EQUIVALENT, 0))
    if equivalent > 0:
        half = _FULL_FRAME_DIAGONAL_MM / 2 / equivalent * max(size) / np.hypot(*size)
    else:
        focal_mm = float(details.get(_FOCAL_LENGTH, 0))
        per_mm = (float(details.get(_PLANE_RESOLUTION, 0))
                  / _UNIT_MM.get(int(details.get(_PLANE_UNIT, 2)), 25.4))
        if not (focal_mm > 0 and per_mm > 0):
            return None
        half = float(details.get(_PIXELS, max(size))) / per_mm / 2 / focal_mm
    return stated_fov_deg(half)


def stated_fov_deg(half: float) -> float | None:
    """Return the field of view by the tangent of its half, None where no file may state it."""
    fov_deg = float(np.degrees(2 * np.arctan(half)))
    return fov_deg if _FIELDS_DEG[0] < fov_deg < _FIELDS_DEG[1] else None


def _taken(details: dict[int, Any]) -> Taken | None:
    """Return DateTimeOriginal with OffsetTimeOriginal, None if there is no valid time."""
    text, offset = (str(details.get(tag, '')).strip(' \0')
                    for tag in (_TIME_ORIGINAL, _OFFSET_ORIGINAL))
    try:
        local = datetime.strptime(text, '%Y:%m:%d %H:%M:%S')
    except ValueError:
        return None
    try:
        zone = datetime.strptime(offset, '%z').tzinfo
    except ValueError:
        zone = None
    return Taken(round(local.replace(tzinfo=zone or UTC).timestamp()) * 10 ** 9, bool(zone))


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image (H, W) turned and mirrored as its EXIF orientation 1 to 8 demands."""
    if orientation >= 5:
        image = image.T
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return np.ascontiguousarray(image[::rows, ::columns])
