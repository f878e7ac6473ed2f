# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fixed pattern of a sensor: sensitivity, dark current and hot pixels."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FixedPattern:
    """Sensitivity response (H, W) float32, mean 1; dark current dark_e_s (H, W) float32, e-/s."""

    response: np.ndarray
    dark_e_s: np.ndarray


def fixed_pattern(shape: tuple[int, int], rng: np.random.Generator, *,
                  flat_field_percent: float, dark_current_e_s: float,
                  hot_pixel_fraction: float, hot_pixel_e_s: float) -> FixedPattern:
    """
    Return the pattern of one sensor.

    Sensitivities are normal about 1. Each pixel is hot with the same probability; hot pixels
    have an exponentially distributed dark current.
    """
    response = np.ones(shape, np.float32)
    if flat_field_percent:
        deviation = rng.standard_normal(shape, np.float32) * np.float32(flat_field_percent / 100)
        response = np.maximum(response + deviation, np.float32(0))
    dark_e_s = np.full(shape, dark_current_e_s, np.float32)
    if hot_pixel_fraction:
        hot = rng.random(shape, np.float32) < hot_pixel_fraction
        dark_e_s[hot] += rng.exponential(hot_pixel_e_s, np.count_nonzero(hot))
    return FixedPattern(response, dark_e_s)
