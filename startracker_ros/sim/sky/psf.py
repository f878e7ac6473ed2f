# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Images of stars: Gaussians integrated over square pixels.

PSFs with coma, astigmatism and defocus are sums of circular Gaussians.
"""

import math

import numpy as np
from startracker_ros.core.native import library

# Third-order coma: the zone of the pupil with the share t of its area forms a circle about
# 2/3 t of the length of the tail, of radius 1/3 t (Born and Wolf, Principles of Optics, 5.3).
_ZONES = (np.arange(5) + 0.5) / 5
_CENTRE = 2 / 3 * _ZONES
_RING_SIGMA = _ZONES / (3 * np.sqrt(2))
PointSources = tuple[np.ndarray, np.ndarray, np.ndarray]

_REACH = 5
"""In sigma, as in native/src/sim/light.cpp."""


def reach_px(sigma_px: float) -> int:
    """Return the radius in px of the image of a source of width sigma_px."""
    return math.ceil(_REACH * sigma_px)


def add_starlight(uv: np.ndarray, electrons: np.ndarray, sigma_px: np.ndarray,
                  response: np.ndarray, light: np.ndarray) -> None:
    """
    Add sources at uv (N, 2) px of electrons (N,) and sigma_px (N,) to light (H, W) float32.

    response (H, W) float32 is the sensitivity of each pixel.
    """
    uv, electrons, sigma_px = (np.ascontiguousarray(array, float)
                               for array in (uv, electrons, sigma_px))
    library().st_add_starlight(
        uv.ctypes.data, electrons.ctypes.data, sigma_px.ctypes.data, len(uv), response.ctypes.data,
        light.shape[1], light.shape[0], light.ctypes.data)


def tail_px(coma_px: float, astigmatism_px: float) -> float:
    """Return an upper bound of the distance from a star to the Gaussians of its image."""
    return _CENTRE[-1] * coma_px + _REACH * abs(astigmatism_px)


def widest_px(sigma_px: float, coma_px: float) -> float:
    """Return the sigma of the widest Gaussian of an image with coma."""
    return float(np.hypot(sigma_px, _RING_SIGMA[-1] * coma_px))


def with_coma(sources: PointSources, field: np.ndarray, coma_px: float) -> PointSources:
    """
    Return the Gaussians of sources uv (N, 2) px, electrons (N,), sigma (N,) px with coma.

    field (N, 2) is the position from the optical axis, 1 in the farthest corner. The tail is
    coma_px long there, points outwards and grows with the distance from the axis.
    """
    uv, electrons, sigma_px = sources
    length_px = coma_px * np.linalg.norm(field, axis=-1)
    return (np.concatenate([uv + coma_px * centre * field for centre in _CENTRE]),
            np.tile(electrons / len(_ZONES), len(_ZONES)),
            np.concatenate([np.hypot(sigma_px, ring * length_px) for ring in _RING_SIGMA]))


def with_ring(sources: PointSources, radius_px: float) -> PointSources:
    """Return the Gaussians of sources as of with_coma(), on a ring around each star."""
    uv, electrons, sigma_px = sources
    # So close to each other that the ring is even to a thousandth.
    count = max(6, int(np.ceil(2 * np.pi * radius_px / (1.2 * sigma_px.min(initial=np.inf)))))
    angle = 2 * np.pi * np.arange(count) / count
    ring = radius_px * np.stack([np.cos(angle), np.sin(angle)], -1)
    return (np.concatenate([uv + point for point in ring]),
            np.tile(electrons / count, count), np.tile(sigma_px, count))


def with_astigmatism(sources: PointSources, field: np.ndarray, astigmatism_px: float
                     ) -> PointSources:
    """
    Return the Gaussians of sources as of with_coma(), with astigmatism.

    astigmatism_px is the sigma in the corner that adds in quadrature along the radius, or
    across it if negative. It grows with the square of the distance from the axis.
    """
    uv, electrons, sigma_px = sources
    line = field * np.linalg.norm(field, axis=-1, keepdims=True) * astigmatism_px
    if astigmatism_px < 0:
        line = line[:, ::-1] * [1, -1]
    # Nodes of Gauss-Hermite quadrature, pi / sqrt(N) apart: at most 1.6 sigma of the PSF.
    count = max(3, int(np.ceil((2 * astigmatism_px / sigma_px.min(initial=np.inf)) ** 2)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return (np.concatenate([uv + node * line for node in nodes]),
            np.concatenate([electrons * weight for weight in weights / weights.sum()]),
            np.tile(sigma_px, count))
