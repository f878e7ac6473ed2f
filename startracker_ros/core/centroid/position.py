# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether the position of a fit is that of its spot, and of no other."""

import math

import numpy as np
from startracker_ros.core.centroid.gaussian_fit import Fit
from startracker_ros.core.centroid.psf import FLUX, U, V
from startracker_ros.core.centroid.windows import Windows
from startracker_ros.core.compiled import compiled

MAX_DRIFT_PX = 1.5  # a fit that ends further from its peak is of something else
SEPARATION_PX = 1.0  # two closer fits are of one star


@compiled
def drifted(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for fits that ended far from their peaks or are NaN."""
    radius, far = windows.data.shape[1] // 2, np.empty(len(fit.parameters), np.bool_)
    for i in range(len(far)):
        far[i] = not (math.hypot(fit.parameters[i, U] - windows.corner[i, 0] - radius,
                                 fit.parameters[i, V] - windows.corner[i, 1] - radius)
                      < MAX_DRIFT_PX)
    return far


@compiled
def duplicates(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for the fainter of two fits closer than SEPARATION_PX."""
    duplicate = np.zeros(len(fit.parameters), np.bool_)
    for i in range(len(duplicate)):
        for k in range(windows.first[i], windows.first[i + 1]):
            star, other = fit.parameters[i], fit.parameters[windows.sources[k]]
            if math.hypot(star[U] - other[U], star[V] - other[V]) < SEPARATION_PX:
                duplicate[i] |= star[FLUX] < other[FLUX]
    return duplicate
