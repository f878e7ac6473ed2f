# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The list of star images found in one frame."""

from dataclasses import dataclass, field, fields

import numpy as np

MADE_BY = 'extract() makes them of an image, Centroids(uv, flux, snr, sigma_px) of a list'

ROUND = np.empty((0, 2, 2))
UNKNOWN_EXPOSURE = (0.0, np.inf)


def round_errors(variance: np.ndarray) -> np.ndarray:
    """Return the covariances (N, 2, 2) of a variance (N,) that is the same on both axes."""
    covariance = np.zeros((len(variance), 2, 2))
    covariance[:, 0, 0] = covariance[:, 1, 1] = variance
    return covariance


@dataclass(frozen=True)
class Centroids:
    """
    Star images of one frame, brightest first; all arrays float64.

    uv (N, 2) px, (0, 0) the centre of the top-left pixel; flux (N,) of the whole star in DN;
    snr (N,) flux over its 1-sigma error; sigma_px (N,) 1-sigma error per axis, the root mean
    square of both; covariance (N, 2, 2) px^2 of uv, round if left empty; delay_s (N,) from the
    time of the frame to the middle of the exposure of the star's own row, zero if left empty;
    common (N, 2, 2) px^2, the same for all stars of an image, the covariance of an error that all
    share, in addition to their own: of non-uniform motion in the exposure; zero if left empty.
    exposure_s are the least and the largest exposure that the image may have had.
    """

    uv: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray
    covariance: np.ndarray = field(default_factory=lambda: ROUND)
    delay_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    common: np.ndarray = field(default_factory=lambda: ROUND)
    exposure_s: tuple[float, float] = UNKNOWN_EXPOSURE

    def __post_init__(self) -> None:
        # Columns of a table are not contiguous.
        for name in ('uv', 'flux', 'snr', 'sigma_px'):
            value = getattr(self, name)
            if not value.flags.c_contiguous:
                object.__setattr__(self, name, np.ascontiguousarray(value))
        if not len(self.covariance):
            object.__setattr__(self, 'covariance', round_errors(self.sigma_px ** 2))
        if not len(self.delay_s):
            object.__setattr__(self, 'delay_s', np.zeros(len(self.flux)))
        if not len(self.common):
            object.__setattr__(self, 'common', np.zeros((len(self.flux), 2, 2)))

    def __len__(self) -> int:
        return len(self.flux)

    @classmethod
    def empty(cls) -> 'Centroids':
        """Return a list without stars."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))

    def joined(self, other: 'Centroids') -> 'Centroids':
        """Return these centroids followed by the others."""
        columns = {column.name: np.concatenate([getattr(self, column.name),
                                                getattr(other, column.name)])
                   for column in fields(self) if column.name != 'exposure_s'}
        return Centroids(**columns, exposure_s=self.exposure_s)

    def select(self, chosen: np.ndarray | slice) -> 'Centroids':
        """Return the centroids of a mask (N,), of indices or of a slice."""
        if isinstance(chosen, np.ndarray) and chosen.dtype == bool and chosen.all():
            return self
        return Centroids(self.uv[chosen], self.flux[chosen], self.snr[chosen],
                         self.sigma_px[chosen], self.covariance[chosen], self.delay_s[chosen],
                         self.common[chosen], self.exposure_s)

    @property
    def correlated_error(self) -> np.ndarray:
        """Return the covariance (2, 2) px^2 of the error that all stars share, zero for none."""
        if not len(self):
            return np.zeros((2, 2))
        return self.common[np.argmax(self.common[:, 0, 0] + self.common[:, 1, 1])]
