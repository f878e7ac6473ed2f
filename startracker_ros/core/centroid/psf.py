# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Gaussian point spread function, integrated over the pixels.

A star of flux F at (u, v) and of width sigma puts the flux F a(x) d(y) into pixel (x, y):

    a(x) = Phi((x + 1/2 - u) / sigma) - Phi((x - 1/2 - u) / sigma),  d(y) likewise with v

Phi(z) = (1 + erf(z / sqrt(2))) / 2 is the normal distribution and phi its density.
"""

import math

import numpy as np
from startracker_ros.core.compiled import fused

U, V, FLUX, LEVEL, SIGMA = range(5)  # columns of the parameters of a star
SHARE, D_CENTRE, D_SIGMA = range(3)  # rows of a profile: a, da/du, da/dsigma
_Z_MAX = 6.0  # beyond this Phi is 0 or 1
_STEPS = 32  # nodes of the tables per standard deviation
_NODES = np.arange(-_Z_MAX * _STEPS, _Z_MAX * _STEPS + 1) / _STEPS
_PHI = np.array([0.5 * math.erfc(-node * math.sqrt(0.5)) for node in _NODES])
_DENSITY = np.exp(-0.5 * _NODES ** 2) / np.sqrt(2 * np.pi)


@fused
def profile(centre: float, sigma: float, first: int, share: np.ndarray) -> None:
    """
    Fill share (3, n) with a, da/du and da/dsigma of the n pixels from `first` on, along one axis.

    With z = (x - u) / sigma at the lower and the upper edge of a pixel:

        da/du = (phi(z_lower) - phi(z_upper)) / sigma
        da/dsigma = (z_lower phi(z_lower) - z_upper phi(z_upper)) / sigma

    Phi and phi are Taylor series in t = z - z0 around the nearest node z0 of a table, good to
    1e-9 and 4e-8, which takes a tenth of the time of erf() and exp():

        Phi(z) = Phi(z0) + phi(z0) t (1 - z0 t / 2 + (z0^2 - 1) t^2 / 6)
        phi(z) = phi(z0) (1 - z0 t + (z0^2 - 1) t^2 / 2 - z0 (z0^2 - 3) t^3 / 6)
    """
    per_sigma, z_first = 1 / sigma, (first - 0.5 - centre) / sigma
    z_lower = density_lower = phi_lower = 0.0
    for k in range(share.shape[1] + 1):
        z = min(max(z_first + k * per_sigma, -_Z_MAX), _Z_MAX)
        node = np.uintp((z + _Z_MAX) * _STEPS + 0.5)
        z0, density0 = node * (1 / _STEPS) - _Z_MAX, _DENSITY[node]
        t, square = z - z0, z0 * z0
        phi = _PHI[node] + density0 * t * (1 - t * (z0 / 2 - t * ((square - 1) / 6)))
        density = density0 * (1 - t * (z0 - t * ((square - 1) / 2
                                                 - t * (z0 * (square - 3) / 6))))
        if k:
            share[SHARE, k - 1] = phi - phi_lower
            share[D_CENTRE, k - 1] = (density_lower - density) * per_sigma
            share[D_SIGMA, k - 1] = (z_lower * density_lower - z * density) * per_sigma
        z_lower, density_lower, phi_lower = z, density, phi
