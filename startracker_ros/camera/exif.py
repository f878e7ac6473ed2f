"""What a camera writes beside its pixels: orientation and focal length (EXIF 2.32)."""

import io
from typing import NamedTuple
import warnings

import numpy as np
from PIL import Image

_ORIENTATION, _SUBFOLDER = 0x0112, 0x8769
_FOCAL_LENGTH, _EQUIVALENT = 0x920a, 0xa405
_PLANE_RESOLUTION, _PLANE_UNIT = 0xa20e, 0xa210
_PIXELS = 0xa002
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_FULL_FRAME_DIAGONAL_MM = 43.27
_FIELDS_DEG = (0.1, 160.0)


class Exif(NamedTuple):
    """Orientation 1 to 8, and the field of view of the long side in deg, None if unknown."""

    orientation: int
    fov_deg: float | None


def read_exif(content: bytes) -> Exif:
    """Return what an image file says; the defaults where it says nothing or nonsense."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            with Image.open(io.BytesIO(content)) as image:
                size, tags = image.size, image.getexif()
                orientation, details = tags.get(_ORIENTATION, 1), tags.get_ifd(_SUBFOLDER)
        return Exif(orientation if orientation in range(1, 9) else 1, _fov_deg(details, size))
    # Pillow raises errors of many types for damaged files; OpenCV names them.
    except Exception:  # noqa: B902
        return Exif(1, None)


def _fov_deg(details: dict[int, float], size: tuple[int, int]) -> float | None:
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
    fov_deg = float(np.degrees(2 * np.arctan(half)))
    return fov_deg if _FIELDS_DEG[0] < fov_deg < _FIELDS_DEG[1] else None


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image (H, W) turned and mirrored as its EXIF orientation 1 to 8 demands."""
    if orientation >= 5:
        image = image.T
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return np.ascontiguousarray(image[::rows, ::columns])
