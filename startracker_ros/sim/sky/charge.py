# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Charge by other than starlight: cosmic rays, trails, and what spills from full pixels."""

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


# --- trails of satellites and aircraft ---

_REACH = 5
"""In sigma, as of stars."""


@compiled
def add_trails(trails: np.ndarray, peak_e: float, sigma_px: float, response: np.ndarray,
               light: np.ndarray) -> None:
    """
    Add trails (N, 4), u, v, du, dv of a point and a unit direction, to light (H, W) float32.

    At distance d from the centre line a pixel gets peak_e sigma / s exp(-d^2 / (2 s^2)), with
    s^2 = sigma^2 + 1/12: the Gaussian widened by the pixel, its flux across the trail kept.
    response (H, W) float32 is the sensitivity of each pixel.
    """
    height, width = light.shape
    s = math.sqrt(sigma_px ** 2 + 1 / 12)
    reach = _REACH * s
    for n in range(len(trails)):
        u, v, du, dv = trails[n]
        for row in range(height):
            # Distance of pixel (column, row): |dv (column - u) - du (row - v)|.
            across = du * (row - v)
            first, last = 0, width - 1
            if abs(dv) * width > 1e-9:
                middle, half = u + across / dv, reach / abs(dv)
                first = int(max(0.0, min(math.ceil(middle - half), float(width))))
                last = int(min(width - 1.0, max(math.floor(middle + half), -1.0)))
            elif abs(across) > reach:
                continue
            for column in range(first, last + 1):
                d = dv * (column - u) - across
                light[row, column] += (peak_e * sigma_px / s * math.exp(-d * d / (2 * s * s))
                                       * response[row, column])


# --- charge that spills from full pixels ---

@compiled
def bloom(light: np.ndarray, full_well_e: float) -> None:
    """
    Move the charge of light (H, W) float32 above full_well_e along its column.

    Half of the excess of each pixel flows up, half down, and fills every pixel to the full well
    until none is left; what reaches the edge of the image is lost. Full pixels end eight
    standard deviations of the photon noise above the full well, at which the read-out clips:
    a full pixel has no photon noise.
    """
    height, width = light.shape
    full = np.float32(full_well_e)
    brim = full + np.float32(8) * np.sqrt(full)
    carried = np.zeros(width, np.float32)
    for row in range(height):
        _flow(light[row], carried, full)
    carried[:] = 0
    for row in range(height - 1, -1, -1):
        _flow(light[row], carried, full)
        for column in range(width):
            if light[row, column] >= full:
                light[row, column] = brim


@compiled
def _flow(line: np.ndarray, carried: np.ndarray, full: np.float32) -> None:
    """Fill one row (W,) with the charge carried (W,) to it, and add half of its own excess."""
    for column in range(len(line)):
        room = full - line[column]
        if room < 0:
            carried[column] -= room / np.float32(2)
        elif carried[column] > 0:
            if carried[column] < room:
                line[column] += carried[column]
                carried[column] = 0
            else:
                line[column] = full
                carried[column] -= room
