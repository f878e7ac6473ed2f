# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of FITS files, read by astropy."""

from datetime import datetime, timedelta, UTC
import io
import math
import re
from typing import Any, NamedTuple
import warnings

import numpy as np
from startracker_ros.core.camera.levels import levels_of
from startracker_ros.core.extras import extra
from startracker_ros.io.images.exif import stated_fov_deg, Taken

BEGIN = b'SIMPLE  ='
_OLD_DATE = re.compile(r'\d\d/\d\d/\d\d')
_LEAP_SECOND = re.compile(r'^([^T]*T\d\d:\d\d:)60')
_MJD_OF_UNIX = 40587.0


class FitsImage(NamedTuple):
    """
    Pixels (H, W) upright, field of view of the long side in deg and time, None if unknown.

    bottom_up is whether the first row of the file is the lowest one of the image, order_known
    whether the header says so. pointing_deg is where the telescope was, right ascension and
    declination, None if unknown. step is that of levels.Levels.
    """

    image: np.ndarray
    fov_deg: float | None
    taken: Taken | None
    bottom_up: bool
    order_known: bool
    pointing_deg: tuple[float, float] | None
    step: float


def read_fits(content: bytes, most_pixels: int) -> FitsImage:
    """
    Return the first image of a FITS file: the mean of three planes, else the first of several.

    ValueError for a file without one or with more pixels; MissingLibraryError without astropy.
    """
    with extra('fits', 'astropy', 'FITS'):
        from astropy.io import fits
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        try:
            with fits.open(io.BytesIO(content), memmap=False) as units:
                unit = _image_unit(units, most_pixels)
                pixels, header = one_plane(unit.data), unit.header.copy()
        except ValueError:
            raise
        # astropy raises errors of many types for damaged files.
        except Exception as error:  # noqa: B902
            raise ValueError(f'astropy cannot read this FITS file: {error}') from error
    # The FITS standard has the first row at the bottom, ROWORDER is what cameras write.
    order = str(header.get('ROWORDER', '')).strip().upper()
    return described(pixels, header, order != 'TOP-DOWN', order in ('TOP-DOWN', 'BOTTOM-UP'))


def described(pixels: np.ndarray, header: Any, bottom_up: bool, order_known: bool) -> FitsImage:
    """Return pixels (H, W) of any number type with what the cards of a header say."""
    # The byte order of a file is that of no array operation of OpenCV.
    native = pixels.astype(pixels.dtype.newbyteorder('='), copy=False)
    image, step = levels_of(np.ascontiguousarray(native[::-1] if bottom_up else native))
    return FitsImage(image, _fov_deg(header, max(image.shape)), _taken(header), bottom_up,
                     order_known, _pointing_deg(header), step)


def one_plane(cube: np.ndarray) -> np.ndarray:
    """Return the image (H, W) of (H, W), of planes (..., H, W) or of colours (H, W, 3)."""
    cube = np.squeeze(cube)
    if cube.ndim == 2:
        return cube
    if cube.shape[-1] == 3:
        return cube.mean(axis=-1, dtype=np.float32)
    planes = cube.reshape(-1, *cube.shape[-2:])
    return planes.mean(axis=0, dtype=np.float32) if len(planes) == 3 else planes[0]


def _image_unit(units: Any, most_pixels: int) -> Any:
    """
    Return the first unit with an image of two sides or more; ValueError names what there is.

    One whose pixels are all the same, as a mask of no bad ones, is the last choice.
    """
    found, uniform = [], None
    for unit in units:
        if not unit.is_image:
            found.append('a table')
            continue
        sides = [side for side in unit.shape if side > 1]
        if len(sides) >= 2:
            if math.prod(sides) > most_pixels:
                raise ValueError(f'{" x ".join(map(str, reversed(sides)))} px, at most '
                                 f'{most_pixels // 1_000_000} million px are solved')
            values = unit.data[np.isfinite(unit.data)]
            if values.size and values.min() < values.max():
                return unit
            uniform = uniform or unit
        if unit.shape:
            found.append('an array of ' + ' x '.join(map(str, unit.shape)))
    if uniform is not None:
        return uniform
    raise ValueError(f'FITS without an image: {", ".join(found) or "empty"}')


def _taken(header: Any) -> Taken | None:
    """
    Return DATE-OBS or MJD-OBS, which are UTC; the hour of a date alone is unknown.

    FITS standard 4.0, section 9: DD/MM/YY is of the twentieth century. Second 60 is the leap
    second, which UNIX time does not have: the next one.
    """
    text = str(header.get('DATE-OBS', '')).strip()
    try:
        if _OLD_DATE.fullmatch(text):
            day, month, year = map(int, text.split('/'))
            time = datetime(1900 + year, month, day)
        else:
            time = datetime.fromisoformat(_LEAP_SECOND.sub(r'\g<1>59', text))
            time += timedelta(seconds=bool(_LEAP_SECOND.match(text)))
    except ValueError:
        return _taken_by_mjd(header.get('MJD-OBS'))
    utc = time if time.tzinfo else time.replace(tzinfo=UTC)
    return Taken(round(utc.timestamp() * 1e6) * 1000, 'T' in text, 'DATE-OBS')


def _taken_by_mjd(value: Any) -> Taken | None:
    try:
        stamp_s = (float(value) - _MJD_OF_UNIX) * 86400
    except (TypeError, ValueError):
        return None
    return Taken(round(stamp_s * 1e3) * 10 ** 6, True, 'MJD-OBS') if abs(stamp_s) < 1e10 else None


def _pointing_deg(header: Any) -> tuple[float, float] | None:
    """Return OBJCTRA and OBJCTDEC, or RA and DEC in deg, which mounts write."""
    for names, ra_unit in ((('OBJCTRA', 'OBJCTDEC'), 15.0), (('RA', 'DEC'), 1.0)):
        ra, dec = (_sexagesimal(header.get(name)) for name in names)
        if ra is not None and dec is not None and abs(dec) <= 90 and abs(ra * ra_unit) <= 360:
            return ra * ra_unit, dec
    return None


def _sexagesimal(value: Any) -> float | None:
    """Return a number of a header, as 5.5 or 05 30 00, or None."""
    try:
        parts = [float(part) for part in str(value).replace(':', ' ').split()]
    except ValueError:
        return None
    if not 1 <= len(parts) <= 3:
        return None
    size = sum(abs(part) / 60 ** k for k, part in enumerate(parts))
    return -size if str(value).strip().startswith('-') else size


def _fov_deg(header: Any, side_px: int) -> float | None:
    """Return the field of view by FOCALLEN in mm and XPIXSZ in um, which includes binning."""
    try:
        half = side_px * 1e-3 * float(header['XPIXSZ']) / 2 / float(header['FOCALLEN'])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return stated_fov_deg(half)
