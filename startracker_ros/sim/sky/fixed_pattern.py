# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fixed pattern of a sensor: sensitivity, dark current, hot pixels, columns and rows that fail."""

from dataclasses import dataclass, fields

import numpy as np

# Charge that a saturated line spills into the next one, relative to the full well; each further
# line gets this fraction of the one before.
_SPILL = 0.3
_SPILL_PX = 4

_NONE = np.zeros(0, int)


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


@dataclass(frozen=True)
class Defects:
    """Numbers of the defective columns and rows (N,); no column has two defects."""

    saturated_columns: np.ndarray
    warm_columns: np.ndarray
    dead_columns: np.ndarray
    saturated_rows: np.ndarray
    dead_rows: np.ndarray

    def counts(self) -> dict[str, int]:
        """Return the number of each kind by name."""
        return {row.name: len(getattr(self, row.name)) for row in fields(self)}


NO_DEFECTS = Defects(_NONE, _NONE, _NONE, _NONE, _NONE)


def draw_defects(shape: tuple[int, int], rng: np.random.Generator, *, saturated_columns: int,
                 warm_columns: int, dead_columns: int, saturated_rows: int, dead_rows: int
                 ) -> Defects:
    """Return the defects of one sensor (H, W), at random lines."""
    rows, columns = map(rng.permutation, shape)
    first, second, third = np.cumsum([saturated_columns, warm_columns, dead_columns])
    return Defects(columns[:first], columns[first:second], columns[second:third],
                   rows[:saturated_rows], rows[saturated_rows:saturated_rows + dead_rows])


def saturated_charge(size: int, saturated: np.ndarray, full_e: float) -> np.ndarray:
    """Return the electrons (size,) float32 in each line from saturated lines and their spill."""
    charge_e = np.zeros(size, np.float32)
    distance = np.abs(np.arange(size) - saturated[:, None])
    for line in distance:
        charge_e += np.where(line <= _SPILL_PX, full_e * _SPILL ** line, 0.0)
    return charge_e
