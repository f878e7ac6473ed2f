"""What differs from pixel to pixel and stays: sensitivity, dark current, hot pixels."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FixedPattern:
    """response (H, W) float32, mean 1; dark_e_s (H, W) float32, thermal electrons a second."""

    response: np.ndarray
    dark_e_s: np.ndarray


def fixed_pattern(shape: tuple[int, int], rng: np.random.Generator, *,
                  flat_field_percent: float, dark_current_e_s: float,
                  hot_pixel_fraction: float, hot_pixel_e_s: float) -> FixedPattern:
    """
    Return the pattern of one sensor.

    Sensitivities are normal about 1. Each pixel is hot with the same probability; the dark
    current of hot pixels is exponentially distributed, most of them mild and a few glaring.
    """
    response = np.ones(shape, np.float32)
    if flat_field_percent:
        spread = rng.standard_normal(shape, np.float32) * np.float32(flat_field_percent / 100)
        response = np.maximum(response + spread, np.float32(0))
    dark_e_s = np.full(shape, dark_current_e_s, np.float32)
    if hot_pixel_fraction:
        hot = rng.random(shape, np.float32) < hot_pixel_fraction
        dark_e_s[hot] += rng.exponential(hot_pixel_e_s, np.count_nonzero(hot))
    return FixedPattern(response, dark_e_s)
