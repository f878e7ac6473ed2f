# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Cameras of FITS headers: TAN with SIP, as astrometry.net writes it, or ZPN, as sip.py does.

The distortion of SIP is any polynomial (sip.py), that of a camera is radial and tangential. The
camera is fitted to the directions of a grid of pixels: Levenberg-Marquardt on focal lengths,
principal point, distortion and the attitude of the optical axis.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.distortion import EQUIDISTANT, MODELS, PLUMB_BOB, RATIONAL
from startracker_ros.core.camera.model import Camera, CameraError, native_camera, unproject
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, quaternion_from_rotation_vector, radec_from_unit, unit_from_radec)

LARGEST_RESIDUAL_PX = 0.5
"""A header whose distortion no camera model has to within this, anywhere in the image, is
rejected."""

SUFFIXES = ('.wcs', '.fits', '.fit', '.fts', '.hdr', '.head')
_LARGEST_HEADER_BYTES = 10_000_000
CARD, BLOCK = 80, 2880  # bytes
_GRID = 21  # pixels along each side
# Of TAN, each with so many terms free.
_MODELS = (PLUMB_BOB, 0), (PLUMB_BOB, 1), (PLUMB_BOB, 5), (RATIONAL, 8)
_ENOUGH_PX = 0.01  # residual at which a model with fewer terms is chosen
# Prior standard deviations of what a narrow field does not determine: principal point (of the
# width), distortion terms. They count little compared with pixels known to _GRID_SIGMA_PX.
_CENTRE, _TERM, _GRID_SIGMA_PX = 0.1, 1.0, 1e-3


class WcsCamera(NamedTuple):
    """
    The camera of a header and the largest residual of its distortion, in px over the image.

    bottom_up is whether the header counts rows from the bottom, as FITS images do: the camera is
    that of the image upright, which read_image() returns.
    """

    camera: Camera
    residual_px: float
    bottom_up: bool


def read_wcs_camera(path: str | Path) -> WcsCamera:
    """
    Return the camera of a FITS file or of a text file with the cards of its header.

    CameraError names what is missing, or the residual of a distortion that no model holds.
    """
    try:
        with open(path, 'rb') as file:
            content = file.read(_LARGEST_HEADER_BYTES)
    except OSError as error:
        raise CameraError(f'camera file {path}: {error.strerror}') from error
    try:
        return _fitted(_wcs_header(content))
    except CameraError as error:
        raise CameraError(f'camera file {path}: {error}') from error
    except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        raise CameraError(f'camera file {path}: no TAN-SIP header ({error!r})') from error


def _wcs_header(content: bytes) -> dict[str, str]:
    """Return the cards of the first header with a projection; values are still text."""
    for header in _headers(content):
        if 'CTYPE1' in header:
            return header
    raise CameraError('no FITS header with CTYPE1')


def _headers(content: bytes) -> Iterator[dict[str, str]]:
    """Yield the cards of each header and data unit, or of the lines of a text file."""
    if b'\n' in content[:CARD + 1]:
        yield _cards(content.decode('ascii', 'replace').splitlines())
        return
    begin = 0
    while begin < len(content):
        lines = []
        while begin < len(content):
            block = content[begin:begin + BLOCK].decode('ascii', 'replace')
            begin += BLOCK
            lines += [block[i:i + CARD] for i in range(0, len(block), CARD)]
            if any(line.rstrip() == 'END' for line in lines):
                break
        header = _cards(lines)
        yield header
        axes = [int(header[f'NAXIS{k + 1}']) for k in range(int(header.get('NAXIS', 0)))]
        if axes:
            size = (abs(int(header['BITPIX'])) // 8 * int(header.get('GCOUNT', 1))
                    * (int(header.get('PCOUNT', 0)) + int(np.prod(axes, dtype=object))))
            begin += -(-size // BLOCK) * BLOCK


def _cards(lines: list[str]) -> dict[str, str]:
    """Return the values of header lines up to END by keyword, without quotes and comments."""
    values = {}
    for line in lines:
        if line.rstrip() == 'END':
            break
        key, mark, value = line.partition('=')
        if not mark:
            continue
        value = value.strip()
        values[key.strip()] = (value[1:].split("'")[0].strip() if value.startswith("'")
                               else value.split('/')[0].strip().replace('D', 'E'))
    return values


def _image_size(header: dict[str, str]) -> tuple[int, int]:
    for names in (('IMAGEW', 'IMAGEH'), ('ZNAXIS1', 'ZNAXIS2'), ('NAXIS1', 'NAXIS2')):
        if all(name in header for name in names):
            width, height = (round(float(header[name])) for name in names)
            return width, height
    raise CameraError('no image size: neither IMAGEW and IMAGEH nor NAXIS1 and NAXIS2')


def _matrix_deg(header: dict[str, str]) -> np.ndarray:
    """Return CD (2, 2) in deg/px, of CD, or of PC or CROTA2 with CDELT."""
    def value(name: str, default: float) -> float:
        return float(header.get(name, default))

    indices = [(i, j) for i in (1, 2) for j in (1, 2)]
    if any(f'CD{i}_{j}' in header for i, j in indices):
        return np.array([value(f'CD{i}_{j}', 0) for i, j in indices]).reshape(2, 2)
    step = np.array([[float(header['CDELT1'])], [float(header['CDELT2'])]])
    if any(f'PC{i}_{j}' in header for i, j in indices):
        return step * np.array([value(f'PC{i}_{j}', i == j) for i, j in indices]).reshape(2, 2)
    turn = np.radians(value('CROTA2', 0))
    # Greisen & Calabretta (2002), equation 189.
    return (np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            * step.T)


def _polynomial(header: dict[str, str], name: str) -> np.ndarray:
    """Return the coefficients (n, n) of u^i v^j at [i, j], zero without that polynomial."""
    order = int(header.get(f'{name}_ORDER', 0))
    return np.array([[float(header.get(f'{name}_{i}_{j}', 0)) for j in range(order + 1)]
                     for i in range(order + 1)])


def header_directions(content: bytes, pixels: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, 3) on ICRS axes of pixels (N, 2) by a header as sip.py writes it."""
    header = _wcs_header(content)
    axis = unit_from_radec(*np.radians([float(header['CRVAL1']), float(header['CRVAL2'])]))
    return _native_directions(header, pixels) @ plane_axes(axis)


def plane_axes(axis: np.ndarray) -> np.ndarray:
    """Return the axes (3, 3) of a plane of projection as rows: east, north, and its axis."""
    ra, _ = radec_from_unit(axis)
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    return np.stack([east, np.cross(axis, east), axis])


def evaluate(polynomials: Iterable[np.ndarray], x: np.ndarray) -> np.ndarray:
    """Return both polynomials (n, n) at x (N, 2)."""
    return np.stack([np.polynomial.polynomial.polyval2d(x[:, 0], x[:, 1], polynomial)
                     for polynomial in polynomials], -1)


def _radial(header: dict[str, str]) -> tuple[float, ...] | None:
    """Return k1 to k4 of ZPN, None of TAN; CameraError for any other projection."""
    for kind in ('TAN', 'ZPN'):
        for end in ('', '-SIP'):
            if (header['CTYPE1'].upper(), header['CTYPE2'].upper()) == (
                    f'RA---{kind}{end}', f'DEC--{kind}{end}'):
                if kind == 'TAN':
                    return None
                terms = [float(header.get(f'PV2_{m}', 0)) for m in range(21)]
                if terms[1] != 1 or any(terms[0::2]) or any(terms[11::2]):
                    raise CameraError('PV2_m of ZPN must be 1 for m = 1, else be of the odd m '
                                      'from 3 to 9')
                return tuple(terms[3:11:2])
    raise CameraError(f'projection {header["CTYPE1"]}, {header["CTYPE2"]} is not TAN or ZPN, '
                      'with or without SIP')


def _native_directions(header: dict[str, str], pixels: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, 3) of pixels (N, 2): east and north of the axis, and along it."""
    offset = pixels - _reference_px(header)
    if header['CTYPE1'].upper().endswith('-SIP'):
        offset = offset + evaluate([_polynomial(header, name) for name in ('A', 'B')], offset)
    plane = np.radians(offset @ _matrix_deg(header).T)
    radial = _radial(header)
    if radial is None:
        direction = np.column_stack([plane, np.ones(len(plane))])
        return direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return unproject(native_camera((1, 1), (1.0, 1.0), (0.0, 0.0), radial, EQUIDISTANT), plane)


def _reference_px(header: dict[str, str]) -> np.ndarray:
    """Return the reference pixel (2,), counted from zero."""
    return np.array([float(header['CRPIX1']), float(header['CRPIX2'])]) - 1


def _fitted(header: dict[str, str]) -> WcsCamera:
    """Return the camera that fits a header best."""
    radial = _radial(header)
    width, height = _image_size(header)
    crpix = _reference_px(header)
    cd = _matrix_deg(header)
    scale_deg = np.sqrt(abs(np.linalg.det(cd)))
    if not 1e-6 < scale_deg < 10:
        raise CameraError(f'{scale_deg:g} deg a pixel is not a camera')
    u, v = np.meshgrid(*(np.linspace(-0.5, side - 0.5, _GRID) for side in (width, height)))
    pixel = np.stack([u.ravel(), v.ravel()], -1)
    # East, north and away from the observer are right-handed axes, as those of the sensor.
    direction = _native_directions(header, pixel)
    seen = np.isfinite(direction).all(axis=1)
    pixel, direction = pixel[seen], direction[seen]
    bottom_up = bool(np.linalg.det(cd) < 0)
    if bottom_up:
        pixel[:, 1], crpix[1] = height - 1 - pixel[:, 1], height - 1 - crpix[1]
        cd = cd * [1, -1]
    focal = 1 / np.radians(scale_deg)
    # Image x and y on the axes of the header: the rotation of its CD.
    turn = np.arctan2(cd[1, 0] - cd[0, 1], cd[0, 0] + cd[1, 1])
    best = None
    for model, terms in (_MODELS if radial is None else ((EQUIDISTANT, 4),)):
        camera = Camera(width, height, focal, focal, *_on_chip(crpix, width, height),
                        radial or (0.0,) * len(MODELS[model].coefficients), model)
        fit, residual_px = _fit(camera, terms, turn, crpix, pixel, direction)
        if fit is not None and (best is None or residual_px < best[1]):
            best = fit, residual_px
        if best is not None and best[1] < _ENOUGH_PX:
            break
    if best is None or best[1] > LARGEST_RESIDUAL_PX:
        left = 'folds the image' if best is None else f'leaves {best[1]:.2g} px'
        raise CameraError(f'its distortion is not one of {", ".join(MODELS)}: best fit {left}, '
                          f'at most {LARGEST_RESIDUAL_PX:g} px are accepted')
    return WcsCamera(*best, bottom_up)


def _on_chip(crpix: np.ndarray, width: int, height: int) -> tuple[float, float]:
    """Return the reference pixel, or the nearest point that is one image size off at most."""
    cx, cy = np.clip(crpix, [-width, -height], [2 * width, 2 * height])
    return float(cx), float(cy)


def _fit(start: Camera, terms: int, turn: float, crpix: np.ndarray, pixel: np.ndarray,
         direction: np.ndarray) -> tuple[Camera | None, float]:
    """
    Return the camera fitted with the first so many distortion terms, and its largest residual.

    pixel (N, 2) has the unit vectors direction (N, 3), turned by turn about the reference pixel.
    """
    from scipy.optimize import least_squares
    first = quaternion_from_rotation_vector(np.array([0.0, 0.0, turn]))
    size = np.array([start.width, start.height])

    def camera_of(x: np.ndarray) -> Camera:
        distortion = (*(np.array(start.distortion[:terms]) + x[4:4 + terms]).tolist(),
                      *start.distortion[terms:])
        return replace(start, fx=float(start.fx * np.exp(x[0])), fy=float(start.fy * np.exp(x[1])),
                       cx=float(start.cx + x[2] * start.width),
                       cy=float(start.cy + x[3] * start.width), distortion=distortion)

    def pixels(x: np.ndarray) -> np.ndarray:
        matrix = (matrix_from_quaternion(first)
                  @ matrix_from_quaternion(quaternion_from_rotation_vector(x[-3:])))
        lens = camera_of(x).project(direction @ matrix)
        return np.where(np.isfinite(lens), lens, 10 * size)

    def errors(x: np.ndarray) -> np.ndarray:
        try:
            residual = (pixels(x) - pixel).ravel() / _GRID_SIGMA_PX
        except CameraError:
            residual = np.full(2 * len(pixel), 1e6 / _GRID_SIGMA_PX)
        return np.concatenate([residual, x[2:4] / _CENTRE, x[4:-3] / _TERM])

    found = least_squares(errors, np.zeros(7 + terms), x_scale='jac')
    try:
        camera, shown = camera_of(found.x), pixels(found.x)
    except CameraError:
        return None, np.inf
    return camera, float(np.hypot(*(shown - pixel).T).max())
