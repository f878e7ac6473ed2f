# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Charge by other than starlight: cosmic rays, trails, and what spills from full pixels."""

import numpy as np
from startracker_ros.core.native import library

# Depth of the silicon from which pixels collect charge; typical of CMOS sensors.
DEPTH_UM = 10.0
# Most probable charge of a minimum ionising particle in thin silicon, and the width of its
# distribution (Particle Data Group, Passage of particles through matter, silicon detectors).
_E_PER_UM, _WIDTH_E_PER_UM = 70.0, 10.0
# Tracks are cut at this length.
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
    tracks = np.column_stack([column, row, azimuth, length_px, electrons])
    library().st_add_tracks(tracks.ctypes.data, hits, width, height, light.ctypes.data)
    return hits


def add_trails(trails: np.ndarray, peak_e: float, sigma_px: float, response: np.ndarray,
               light: np.ndarray) -> None:
    """
    Add trails (N, 4), u, v, du, dv of a point and a unit direction, to light (H, W) float32.

    peak_e electrons a pixel are on the centre line of a Gaussian of sigma_px, which is widened by
    the pixel. response (H, W) float32 is the sensitivity of each pixel.
    """
    trails = np.ascontiguousarray(trails, float)
    library().st_add_trails(trails.ctypes.data, len(trails), peak_e, sigma_px,
                            response.ctypes.data, light.shape[1], light.shape[0],
                            light.ctypes.data)


def bloom(light: np.ndarray, full_well_e: float) -> None:
    """
    Move the charge of light (H, W) float32 above full_well_e along its column.

    Half of the excess of each pixel flows up, half down, and fills every pixel to the full well
    until none is left; what reaches the edge of the image is lost. Full pixels end eight
    standard deviations of the photon noise above the full well, at which the read-out clips.
    """
    library().st_bloom(light.ctypes.data, light.shape[1], light.shape[0], full_well_e)
