"""K-vector: index ranges of a sorted array in constant time (Mortari and Neta 2000)."""

from typing import NamedTuple

import numpy as np
from startracker_ros.compiled import compiled, inlined


class KVectorTable(NamedTuple):
    """Sorted values (N,) float64 and how many of them, below (N + 1,), lie under each step."""

    values: np.ndarray
    below: np.ndarray
    start: float
    per_step: float


class KVector:
    """
    Range search over sorted values (N,).

    A straight line from the first value to the last cuts the range into N steps; step i
    knows how many values lie below it (Yuan, Zhang, Shi 2017, section 2). A range maps to
    steps by division, and only the values that share a step with its ends are compared.
    """

    def __init__(self, values: np.ndarray) -> None:
        values = np.ascontiguousarray(values, float)
        count = len(values)
        start, last = values[[0, -1]] if count else (0.0, 0.0)
        step = (last - start) / count if last > start else 1.0
        below = np.searchsorted(values, start + step * np.arange(count + 1))
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
    """Return the place of the first value that is not below low."""
    # The division rounds, hence the look to both sides.
    place = table.below[_step(table, low)]
    while place > 0 and table.values[place - 1] >= low:
        place -= 1
    while place < len(table.values) and table.values[place] < low:
        place += 1
    return place


@compiled
def first_beyond(table: KVectorTable, high: float) -> int:
    """Return the place of the first value above high."""
    place = table.below[_step(table, high)]
    while place > 0 and table.values[place - 1] > high:
        place -= 1
    while place < len(table.values) and table.values[place] <= high:
        place += 1
    return place
