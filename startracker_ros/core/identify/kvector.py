# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""K-vector: index ranges of a sorted array in constant time (Mortari and Neta 2000)."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, inlined


class KVectorTable(NamedTuple):
    """Sorted values (N,) float64, and below (N + 1,), the number of values under each step."""

    values: np.ndarray
    below: np.ndarray
    start: float
    per_step: float


class KVector:
    """
    Range search over sorted values (N,).

    The line z(i) = start + i / per_step, from the first value to the last in N steps, and the
    number below[i] of values under z(i) (Yuan, Zhang, Shi 2017, section 2). A limit maps to
    its step by i = (limit - start) per_step; only the values of that step are compared.
    """

    def __init__(self, values: np.ndarray, below: np.ndarray | None = None) -> None:
        """Count the values under each step, unless below (N + 1,) has them."""
        values = np.ascontiguousarray(values, float)
        count = len(values)
        start, last = values[[0, -1]] if count else (0.0, 0.0)
        step = (last - start) / count if last > start else 1.0
        if below is None:
            below = np.searchsorted(values, start + step * np.arange(count + 1)).astype(np.int32)
            below[-1] = count
        self.table = KVectorTable(values, below, float(start), float(1 / step))

    def between(self, low: float, high: float) -> slice:
        """Return the slice of the values with low <= value <= high."""
        first = first_from(self.table, low)
        return slice(first, max(first, first_beyond(self.table, high)))


@inlined
def _step(table: KVectorTable, value: float) -> int:
    """Return the step that a value falls into, the first one for NaN."""
    step = (value - table.start) * table.per_step
    return int(min(step, len(table.values))) if step > 0 else 0


@compiled
def first_from(table: KVectorTable, low: float) -> int:
    """Return the index of the first value that is not below low."""
    # The division rounds, hence the comparison to both sides.
    index = table.below[_step(table, low)]
    while index > 0 and table.values[index - 1] >= low:
        index -= 1
    while index < len(table.values) and table.values[index] < low:
        index += 1
    return index


@compiled
def first_beyond(table: KVectorTable, high: float) -> int:
    """Return the index of the first value above high."""
    index = table.below[_step(table, high)]
    while index > 0 and table.values[index - 1] > high:
        index -= 1
    while index < len(table.values) and table.values[index] <= high:
        index += 1
    return index
