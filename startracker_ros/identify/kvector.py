"""K-vector: index ranges of a sorted array in constant time (Mortari and Neta 2000)."""

import numpy as np


class KVector:
    """Range search over sorted values (N,).

    A straight line from the first value to the last cuts the range into N steps; step i
    knows how many values lie below it (Yuan, Zhang, Shi 2017, section 2). A range maps to
    steps by division, and only the values that share a step with its ends are compared.
    """

    def __init__(self, values: np.ndarray) -> None:
        self._values = np.asarray(values, float)
        count = len(self._values)
        self._start, last = self._values[[0, -1]] if count else (0.0, 0.0)
        self._step = (last - self._start) / count if last > self._start else 1.0
        edges = self._start + self._step * np.arange(count + 1)
        self._below = np.searchsorted(self._values, edges)
        self._below[-1] = count

    def range(self, low: float, high: float) -> slice:
        """Return the slice of the values with low <= value <= high."""
        begin, end = self._bracket(low), self._bracket(high)
        values = self._values
        first = begin.start + np.searchsorted(values[begin], low, 'left')
        last = end.start + np.searchsorted(values[end], high, 'right')
        return slice(int(first), int(max(first, last)))

    def _bracket(self, value: float) -> slice:
        """Return a slice that holds the place of a value in the order."""
        step = int(min(max((value - self._start) / self._step, 0), len(self._below) - 1))
        # One step more on each side, because the division rounds.
        last = len(self._below) - 1
        return slice(self._below[max(step - 1, 0)], self._below[min(step + 2, last)])
