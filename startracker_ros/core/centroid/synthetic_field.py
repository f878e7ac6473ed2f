# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fields without an image: the centroids of catalogue stars, with simulated errors."""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import conjugate, rotate


def star_list(onboard: OnboardCatalog, camera: Camera, q: np.ndarray, sigma_px: float,
              rng: np.random.Generator, *, magnitude_sigma: float = 0.1, missing: float = 0.0,
              false: int = 0, brightest_false: float = 1.0, exposed: np.ndarray | None = None
              ) -> tuple[Centroids, np.ndarray]:
    """
    Return simulated centroids of a camera at attitude q (4,), and their hip (N,).

    Each axis has Gaussian noise of sigma_px; each star is missing with the given
    probability. False stars, hip 0, are uniform over the image and in magnitude from
    brightest_false to the faintest star of the on-board catalogue. Of an exposure with attitudes
    exposed (K, 4) after equal times, the centroids are where the flux has its centre.
    """
    near = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    uv = camera.project(rotate(conjugate(q), onboard.direction[near]))
    visible = camera.contains(uv) & (rng.random(len(near)) >= missing)
    if exposed is not None:
        uv = np.mean([camera.project(rotate(conjugate(one), onboard.direction[near]))
                      for one in exposed], axis=0)
    near, uv = near[visible], uv[visible] + rng.normal(0, sigma_px, (np.count_nonzero(visible), 2))
    magnitude = onboard.magnitude[near] + rng.normal(0, magnitude_sigma, len(near))
    uv = np.concatenate([uv, rng.uniform(-0.5, [camera.width - 0.5, camera.height - 0.5],
                                         (false, 2))])
    magnitude = np.concatenate([magnitude, rng.uniform(
        brightest_false, onboard.magnitude.max(initial=brightest_false), false)])
    hip = np.concatenate([onboard.hip[near], np.zeros(false, np.int32)])
    order = np.argsort(magnitude)
    count = len(order)
    error = max(sigma_px, 1e-3)
    return Centroids(uv=uv[order], flux=1e6 * 10 ** (-0.4 * magnitude[order]),
                     snr=np.full(count, 1 / error), sigma_px=np.full(count, error)), hip[order]
