# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Directions of stars for tests, with errors across the line of sight."""

import numpy as np


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return the unit vectors (..., 3) along others."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def field(rng: np.random.Generator, count: int, half_angle_rad: float = 0.1) -> np.ndarray:
    """Return directions (N, 3) in a square field about +z."""
    tangent = rng.uniform(-1, 1, (count, 2)) * np.tan(half_angle_rad)
    return unit(np.concatenate([tangent, np.ones((count, 1))], -1))


def blurred(true: np.ndarray, sigma_rad: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return directions (N, 3) with Gaussian errors of sigma_rad (N,) across the line of sight."""
    noise = rng.normal(0, 1, true.shape) * sigma_rad[:, None]
    return unit(true + noise - true * np.sum(noise * true, -1, keepdims=True))
