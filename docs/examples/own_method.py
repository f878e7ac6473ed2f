# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A custom identification method: triangles of the brightest stars, by brute force."""

from itertools import combinations

import numpy as np
import startracker_ros as st


class BrightTriangles(st.CandidateIdentifier):
    """Yields candidates; the field verifies them."""

    def candidates(self, field):
        sky = self.onboard.direction
        separation = np.arccos(np.clip(sky @ sky.T, -1, 1))
        for base in combinations(range(min(len(field), 6)), 3):
            a, b, c = field.direction[list(base)]
            reach = 5 * field.sigma_rad[list(base)].max()
            near = [np.abs(separation - np.arccos(x @ y)) < reach
                    for x, y in ((a, b), (a, c), (b, c))]
            stars = [(i, j, k) for i, j in np.argwhere(near[0])
                     for k in np.flatnonzero(near[1][i] & near[2][j])]
            yield st.Candidates(np.array(base), np.array(stars).reshape(-1, 3))


camera = st.Camera.from_fov(512, 512, 20.0)
sky = st.SkySimulator(camera, 2026.5, aberration=False)
centroids = st.extract(sky.frame(0.0).image, max_stars=20).centroids
for method in 'pyramid', BrightTriangles:
    found = st.identify(centroids, camera, epoch_year=2026.5, method=method, aberration='none',
                        magnitude_limit=5.5)
    print(found.status, found.matched, sorted(found.hip[found.hip > 0].tolist())[:4])
