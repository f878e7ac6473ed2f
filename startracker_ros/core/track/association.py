# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The JPDA filter of single stars, as the native core follows them: predict, associate, update.

Sadeghi, Sabahi and Saberali; native/src/track/association.h and jpdaf.h have their equations.
"""

import ctypes
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.centroid.image_tracker import aligned
from startracker_ros.core.track.options import ASSOCIATIONS


class DetectionModel(NamedTuple):
    """
    Gate, probabilities of a detection, and false centroids.

    gate_probability is that of a detected star to be inside its gate; detection_probability that
    of a star to have a centroid; image_px2 is the area in which false centroids occur. Their
    density is clutter_px2, or as association, one of ASSOCIATIONS, has it.
    """

    gate_probability: float
    detection_probability: float
    image_px2: float
    clutter_px2: float = 0.0
    association: str = 'poisson'

    @property
    def gate(self) -> float:
        """Return the squared Mahalanobis distance in two dimensions of the gate."""
        return float(-2 * np.log1p(-self.gate_probability))


class StarFilter:
    """
    Tracks of stars: state (N, 4) is [u, u_rate, v, v_rate], covariance (N, 4, 4).

    Frames of up to most_centroids are taken. Arguments are finite, covariances positive
    semidefinite and variances positive; the caller ensures it.
    """

    def __init__(self, detection: DetectionModel, state: np.ndarray, covariance: np.ndarray,
                 most_centroids: int) -> None:
        self.state, self.covariance = np.array(state, float), np.array(covariance, float)
        self._detection = np.array(
            (detection.gate, *detection[:4], ASSOCIATIONS.index(detection.association), 0),
            native.DETECTION)
        size = ctypes.c_size_t()
        native.check(native.library().st_cycle_size(
            len(self.state), most_centroids, ctypes.byref(size)))
        self._memory = aligned(size.value)

    def step(self, transition: np.ndarray, noise: np.ndarray, uv: np.ndarray,
             variance: np.ndarray) -> np.ndarray:
        """
        Predict, associate and update; return the probabilities (N, M + 1), of a missed star first.

        transition and noise are (4, 4); centroids uv (M, 2) have a variance (M,) px^2 per axis.
        """
        transition, noise, uv, variance = (
            np.ascontiguousarray(array, float) for array in (transition, noise, uv, variance))
        probability = np.empty((len(self.state), len(uv) + 1))
        native.check(native.library().st_cycle(
            self._memory.ctypes.data, len(self._memory), self._detection.ctypes.data,
            transition.ctypes.data, noise.ctypes.data, self.state.ctypes.data,
            self.covariance.ctypes.data, len(self.state), uv.ctypes.data, variance.ctypes.data,
            len(uv), probability.ctypes.data))
        return probability
