# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a published covariance consists of."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import ARCSEC

NO_ERROR = np.zeros((3, 3))


class ErrorBudget(NamedTuple):
    """
    The covariances (3, 3) rad^2 about sensor axes that add up to that of an attitude.

    stars        noise of centroids and catalogue, through the filter: filter/motion.h
    motion       motions that may begin in the frame, and their flux: filter/motion.h
    exposure     shaking within the exposure, alike for all stars: centroids
    stamps       errors of the stamps, times the rate: integrity/stamp_jitter.h
    shutter      errors of line_time_us, times the rate: track/attitude_model.h
    lens         errors of the lens that stay from frame to frame: integrity/lens_error.h
    observer     its unknown velocity, by aberration: observer_motion.py
    epoch        unknown date, by proper motion: systematic_errors.py
    """

    stars: np.ndarray = NO_ERROR
    motion: np.ndarray = NO_ERROR
    exposure: np.ndarray = NO_ERROR
    stamps: np.ndarray = NO_ERROR
    shutter: np.ndarray = NO_ERROR
    lens: np.ndarray = NO_ERROR
    observer: np.ndarray = NO_ERROR
    epoch: np.ndarray = NO_ERROR

    @property
    def covariance(self) -> np.ndarray:
        """The sum (3, 3) of all."""
        total: np.ndarray = sum(self[1:], self[0])
        return total

    @property
    def sigma_arcsec(self) -> dict[str, np.ndarray]:
        """1 sigma (3,) about sensor axes of each term."""
        return {name: np.sqrt(np.maximum(np.diag(term), 0.0)) / ARCSEC
                for name, term in self._asdict().items()}
