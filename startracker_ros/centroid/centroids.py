"""The list of star images found in one frame."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Centroids:
    """
    Star images of one frame, brightest first; all arrays float64.

    uv (N, 2) px, (0, 0) the centre of the top-left pixel; flux (N,) total light in DN;
    snr (N,) flux over its 1-sigma error; sigma_px (N,) 1-sigma error per axis.
    """

    uv: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray

    def __len__(self) -> int:
        return len(self.flux)

    @classmethod
    def empty(cls) -> 'Centroids':
        """Return a list without stars."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))

    def select(self, chosen: np.ndarray | slice) -> 'Centroids':
        """Return the centroids of a mask (N,), of indices or of a slice."""
        return Centroids(self.uv[chosen], self.flux[chosen], self.snr[chosen],
                         self.sigma_px[chosen])
