# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks of charged particles through the sensor."""

import math

import numpy as np
from startracker_ros.core.compiled import compiled

# Depth of the silicon from which pixels collect charge; typical of CMOS sensors.
DEPTH_UM = 10.0
# Most probable charge of a minimum ionising particle in thin silicon, and the width of its
# distribution (Particle Data Group, Passage of particles through matter, silicon detectors).
_E_PER_UM, _WIDTH_E_PER_UM = 70.0, 10.0
# Tracks are drawn in steps of a quarter pixel and cut at 200 px.
_STEPS_PER_PX = 4
_MAX_LENGTH_PX = 200.0


def add_cosmic_rays(light: np.ndarray, hits_mean: float, pitch_um: float,
                    rng: np.random.Generator) -> int:
    """
    Add to light (H, W) the electrons of a Poisson number of particles; return the number.

    The flux is isotropic. The charge per length follows the distribution of Moyal (1955), an
    approximation of the Landau distribution.
    """
    height, width = light.shape
    hits = int(rng.poisson(hits_mean))
    # For an isotropic flux through a plane, sin^2 of the zenith angle is uniform.
    sine2 = np.minimum(rng.random(hits), 1 - 1e-6)
    azimuth = rng.uniform(0, 2 * np.pi, hits)
    length_px = np.minimum(DEPTH_UM / pitch_um * np.sqrt(sine2 / (1 - sine2)), _MAX_LENGTH_PX)
    e_per_um = _E_PER_UM - _WIDTH_E_PER_UM * np.log(rng.standard_normal(hits) ** 2)
    electrons = np.maximum(e_per_um, 0.0) * np.hypot(DEPTH_UM, length_px * pitch_um)
    column = rng.random(hits) * width - 0.5
    row = rng.random(hits) * height - 0.5
    _add_tracks(light, column, row, azimuth, length_px, electrons)
    return hits


@compiled
def _add_tracks(light: np.ndarray, column: np.ndarray, row: np.ndarray, azimuth: np.ndarray,
                length_px: np.ndarray, electrons: np.ndarray) -> None:
    """Add electrons (N,), spread evenly over tracks that start at column, row (N,), to light."""
    height, width = light.shape
    for n in range(len(column)):
        steps = int(math.ceil(length_px[n] * _STEPS_PER_PX)) + 1
        along = length_px[n] / max(steps - 1, 1)
        across, down = along * math.cos(azimuth[n]), along * math.sin(azimuth[n])
        for step in range(steps):
            i = int(np.rint(row[n] + step * down))
            j = int(np.rint(column[n] + step * across))
            if 0 <= i < height and 0 <= j < width:
                light[i, j] += electrons[n] / steps
