"""Many draws of one discrete random variable, fast and exact."""

import numpy as np

_CELLS = 1 << 16


class TableSampler:
    """Table look-up with 16 random bits a draw, exact up to the rounding of the given weights.

    Every value fills floor(65536 p) cells of a table. The few cells left over stand for the
    remainders of all values; a draw that lands there is decided by a second, exact draw
    (the idea of Marsaglia, Tsang and Wang, J. Stat. Software 11(3), 2004).
    """

    def __init__(self, values: np.ndarray, probability: np.ndarray) -> None:
        """Take values (K,) and their probabilities (K,), which sum to 1."""
        copies = np.floor(probability * _CELLS).astype(int)
        self._values = values
        self._sure = int(copies.sum())
        self._table = np.resize(np.repeat(values, copies), _CELLS)
        self._remainder = np.cumsum(probability * _CELLS - copies)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return (count,) independent values."""
        words = rng.integers(2 ** 64, size=-(-count // 4), dtype=np.uint64)
        cell = words.view(np.uint16)[:count]
        sample = np.take(self._table, cell)
        rare = np.flatnonzero(cell >= self._sure)
        pick = rng.random(rare.size) * self._remainder[-1]
        sample[rare] = self._values[np.searchsorted(self._remainder, pick)]
        return sample
