# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Columns and rows that do not work: saturated, warm, dead."""

from dataclasses import dataclass, fields

import numpy as np

# Charge that a saturated line spills into the next one, relative to the full well; each further
# line gets this fraction of the one before.
_SPILL = 0.3
_SPILL_PX = 4

_NONE = np.zeros(0, int)


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
