# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Sky coordinates of pixels as a FITS header: TAN or ZPN projection with SIP distortion.

Calabretta & Greisen (2002), A&A 395, 1077 (CTYPE, CRVAL, CRPIX, CD, TAN, ZPN); Shupe et al.
(2005), ASP 347, 491 (SIP). With u, v the offsets from CRPIX, f = sum A_ij u^i v^j and g = sum B_ij
u^i v^j, the coordinates in the plane of projection are CD (u + f, v + g). AP and BP are the
inverse: u = U + sum AP_ij U^i V^j of U = u + f, V = v + g.

A tangent plane has no place for what a fisheye sees. Its radius in ZPN is sum PV2_m theta^m of the
angle theta to the axis, which is the equidistant model of distortion.py with PV2_1 = 1, PV2_3 = k1
to PV2_9 = k4: it needs SIP for refraction and aberration only.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.wcs_file import (
    BLOCK, CARD, evaluate, header_directions, plane_axes)

_LOWEST_ORDER, _HIGHEST_ORDER = 2, 9  # SIP has no higher one
_NO_SIP = 1  # the order of no polynomials
_ENOUGH_PX = 0.002
_GRID, _CHECK_GRID = 29, 32  # points along each side of the image

Directions = Callable[[np.ndarray], np.ndarray]
"""Unit vectors (N, 3) on ICRS axes of pixels (N, 2), (0, 0) the centre of the first pixel."""

Cards = dict[str, float | str]
"""Values of a FITS header by keyword."""

_MOST_WCS_ERROR_PX = 0.5  # of a star


class Sip(NamedTuple):
    """
    Reference pixel (2,) counted from one, its sky coordinates (2,) deg, CD (2, 2) deg/px.

    a, b, ap, bp (order + 1, order + 1) have the coefficient of u^i v^j at [i, j]; error_px and
    inverse_error_px are the largest errors over the image. radial are k1 to k4 of ZPN, None of
    TAN.
    """

    crpix: np.ndarray
    crval_deg: np.ndarray
    cd: np.ndarray
    a: np.ndarray
    b: np.ndarray
    ap: np.ndarray
    bp: np.ndarray
    error_px: float
    inverse_error_px: float
    radial: tuple[float, ...] | None = None

    @property
    def order(self) -> int:
        """Return the order of the polynomials."""
        return len(self.a) - 1


def fit_sip(directions: Directions, width: int, height: int, reference_px: np.ndarray,
            radial: tuple[float, ...] | None = None) -> Sip:
    """
    Return the SIP polynomials of an image, of the lowest order that is good to 0.002 px.

    reference_px (2,) is the pixel at which the plane of projection touches the sky, best the
    principal point: an ideal lens then has no distortion. radial are k1 to k4 of an equidistant
    lens, whose pixels without a direction do not count. LinAlgError where no polynomial fits.
    """
    best = None
    for order in range(_LOWEST_ORDER if radial is None else _NO_SIP, _HIGHEST_ORDER + 1):
        sip = _fit(directions, width, height, reference_px, order, radial)
        if best is None or sip.error_px + sip.inverse_error_px < (
                best.error_px + best.inverse_error_px):
            best = sip
        if max(sip.error_px, sip.inverse_error_px) < _ENOUGH_PX:
            break
    assert best is not None
    return best


def _fit(directions: Directions, width: int, height: int, reference_px: np.ndarray, order: int,
         radial: tuple[float, ...] | None) -> Sip:
    axis, = directions(reference_px[None])
    scale = float(max(width, height))

    def seen_from(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return offsets (N, 2) from the reference and plane coordinates (N, 2) deg of pixels."""
        pixels = _grid(width, height, nodes)
        with np.errstate(invalid='ignore'):
            direction = directions(pixels)
        seen = np.isfinite(direction).all(axis=1)
        return pixels[seen] - reference_px, np.degrees(
            _on_plane(direction[seen], axis, radial))

    # Dense towards the edges, as Chebyshev's, so that the error is as large in the middle.
    offset, plane_deg = seen_from(-np.cos(np.linspace(0, np.pi, _GRID)))
    check_offset, check_deg = seen_from(np.linspace(-1, 1, _CHECK_GRID))
    # Without a constant, because the reference pixel has the reference direction.
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    terms = powers[1:]
    solved = _least_squares(offset / scale, plane_deg, terms)
    cd = np.stack([solved[terms.index((1, 0))], solved[terms.index((0, 1))]], -1) / scale
    inverse = np.linalg.inv(cd)
    polynomials = np.zeros((2, order + 1, order + 1))
    for (i, j), coefficient in zip(terms, solved @ inverse.T):
        if i + j > 1:
            polynomials[:, i, j] = coefficient / scale ** (i + j)
    undistorted = offset + evaluate(polynomials, offset)
    back = np.zeros_like(polynomials)
    for (i, j), coefficient in zip(powers, _least_squares(
            undistorted / scale, offset - undistorted, powers)):
        back[:, i, j] = coefficient / scale ** (i + j)
    seen = check_offset + evaluate(polynomials, check_offset)
    true = check_deg @ inverse.T
    ra, dec = radec_from_unit(axis)
    return Sip(reference_px + 1, np.degrees([ra, dec]), cd,
               polynomials[0], polynomials[1], back[0], back[1],
               float(np.abs(seen - true).max()),
               float(np.abs(true + evaluate(back, true) - check_offset).max()), radial)


def _grid(width: int, height: int, nodes: np.ndarray) -> np.ndarray:
    """Return pixels (N^2, 2) at nodes (N,) from -1 to 1 of both sides, edge to edge."""
    u, v = ((nodes + 1) / 2 * side - 0.5 for side in (width, height))
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)


def _on_plane(directions: np.ndarray, axis: np.ndarray, radial: tuple[float, ...] | None
              ) -> np.ndarray:
    """Return the plane coordinates (N, 2), towards east and north, in rad."""
    native = directions @ plane_axes(axis).T
    if radial is None:
        return native[:, :2] / native[:, 2:]
    across = np.hypot(native[:, 0], native[:, 1])
    theta = np.arctan2(across, native[:, 2])
    radius = theta * np.polynomial.polynomial.polyval(theta ** 2, (1.0, *radial))
    return native[:, :2] * (radius / np.where(across > 0, across, 1.0))[:, None]


def _least_squares(x: np.ndarray, values: np.ndarray, powers: list[tuple[int, int]]
                   ) -> np.ndarray:
    """Return the coefficients (P, 2) of powers of x (N, 2) that fit values (N, 2)."""
    design = np.stack([x[:, 0] ** i * x[:, 1] ** j for i, j in powers], -1)
    return np.linalg.lstsq(design, values, rcond=None)[0]


def _cards(sip: Sip, width: int, height: int) -> Cards:
    (cd11, cd12), (cd21, cd22) = sip.cd.tolist()
    kind = ('TAN' if sip.radial is None else 'ZPN') + ('-SIP' if sip.order > _NO_SIP else '')
    cards: Cards = {
        'WCSAXES': 2,
        'CTYPE1': f'RA---{kind}', 'CTYPE2': f'DEC--{kind}', 'CUNIT1': 'deg', 'CUNIT2': 'deg',
        'CRPIX1': float(sip.crpix[0]), 'CRPIX2': float(sip.crpix[1]),
        'CRVAL1': float(sip.crval_deg[0]), 'CRVAL2': float(sip.crval_deg[1]),
        'CD1_1': cd11, 'CD1_2': cd12, 'CD2_1': cd21, 'CD2_2': cd22,
        'LONPOLE': 180.0, 'RADESYS': 'ICRS', 'IMAGEW': width, 'IMAGEH': height}
    if sip.radial is not None:
        cards |= {f'PV2_{2 * k + 1}': value for k, value in enumerate((1.0, *sip.radial))}
    for name in ('a', 'b', 'ap', 'bp') if sip.order > _NO_SIP else ():
        polynomial = getattr(sip, name)
        cards[f'{name.upper()}_ORDER'] = sip.order
        cards |= {f'{name.upper()}_{i}_{j}': float(polynomial[i, j])
                  for i, j in zip(*np.nonzero(polynomial))}
    cards['COMMENT'] = (f'This is within {sip.error_px:.1g} px of the lens, '
                        f'its inverse within {sip.inverse_error_px:.1g} px')
    return cards


def wcs_header(cards: Cards) -> bytes:
    """Return the FITS header of an image without its pixels, as `.wcs` files have it."""
    no_pixels: Cards = {'SIMPLE': True, 'BITPIX': 8, 'NAXIS': 0}
    lines = [_card(key, value) for key, value in (no_pixels | cards).items()]
    text = ''.join(line.ljust(CARD) for line in (*lines, 'END'))
    return text.ljust(-(-len(text) // BLOCK) * BLOCK).encode('ascii')


def _card(key: str, value: float | str) -> str:
    """Return a card of fixed format, FITS standard 4.0, section 4.2."""
    if key == 'COMMENT':
        return f'{key} {value}'
    if isinstance(value, bool):
        text = f'{"T" if value else "F":>20}'
    elif isinstance(value, str):
        text = f"'{value:<8}'"
    elif isinstance(value, int):
        text = f'{value:>20}'
    else:
        text = f'{value!r:>20}'.upper()
    return f'{key:<8}= {text}'


class WcsError(ValueError):
    """An image of which no FITS header says where its stars are."""


def image_wcs(sky: SkyMapping, mirrored: bool = False, bottom_up: bool = False,
              stars_px: np.ndarray = np.empty((0, 2))) -> Cards:
    """
    Return the FITS header of an image with columns and rows in the order of its file.

    WcsError where it has the pixels stars_px (N, 2) of the image elsewhere on the sky.
    """
    camera = sky.camera
    turned = np.array([mirrored, bottom_up])
    last = np.array([camera.width, camera.height]) - 1.0

    def other(pixels: np.ndarray) -> np.ndarray:
        """Return pixels of the file as those of the image, or the other way."""
        return np.where(turned, last - pixels, pixels)

    try:
        sip = fit_sip(lambda pixels: sky.directions(other(pixels)), camera.width, camera.height,
                      other(np.array([camera.cx, camera.cy])),
                      camera.distortion if camera.model.equidistant else None)
    except np.linalg.LinAlgError as error:
        raise WcsError(f'no FITS projection has its lens: {error}') from error
    cards = _cards(sip, camera.width, camera.height)
    # As a reader has it, by the text alone.
    off_px = np.abs(sky.pixels(
        header_directions(wcs_header(cards), other(stars_px))) - stars_px)
    if not (off_px < _MOST_WCS_ERROR_PX).all():
        raise WcsError(f'no FITS projection has its lens: the best one has stars '
                       f'{np.nanmax(off_px):.2g} px off, at most {_MOST_WCS_ERROR_PX:g} px are '
                       'written')
    return cards
