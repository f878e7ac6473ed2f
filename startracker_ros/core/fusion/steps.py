# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps of mounts: one head's attitude against the reference's, before and after a time."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import ARCSEC

BLOCK_S = 10.0
WINDOW_S = 900.0

_LEAST_FRAMES = 3  # of each head in a block
_LEAST_BEFORE, _LEAST_AFTER = 12, 6  # blocks
_THRESHOLD = 50.0
"""Chi-square of a step about three axes: chance exceeds it in one of 1e10 blocks."""

_LEAST_SCATTER = 1e-3  # of frames, of the variance that they are expected to have
_LEAST_STRENGTH = 1e-6  # of a singular value, of the largest one
_LEAST_RAD = 2 * ARCSEC  # faster bending than the law of the window is no step


@dataclass(frozen=True)
class MountStep:
    """A step of a mount against the reference: size (3,) rad about body axes, 1 sigma (3,)."""

    head: str
    stamp_ns: int
    size_rad: np.ndarray
    sigma_rad: np.ndarray


class _Block:
    """Weighted sums of the offsets of one head over BLOCK_S, and of its law phi (L,)."""

    def __init__(self) -> None:
        self.count = 0
        self._weight, self._total, self._squares = np.zeros(3), np.zeros(3), np.zeros(3)
        self._law: np.ndarray | float = 0.0

    def add(self, offset_rad: np.ndarray, variance_rad2: np.ndarray, law: np.ndarray) -> None:
        self.count += 1
        self._weight += 1 / variance_rad2
        self._total += offset_rad / variance_rad2
        self._squares += offset_rad * offset_rad / variance_rad2
        self._law = self._law + law

    def mean(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the average (3,), its variance (3,), and that by the scatter of the frames."""
        mean = self._total / self._weight
        scatter = (self._squares - self._weight * mean * mean) / (self.count - 1)
        return mean, 1 / self._weight, scatter / self._weight

    @property
    def law(self) -> np.ndarray:
        """Return the mean of phi (L,)."""
        return np.asarray(self._law) / self.count


class _Difference(NamedTuple):
    """A head minus the reference (3,) rad in a block, its variances as of _Block, its law."""

    number: int
    offset_rad: np.ndarray
    variance: np.ndarray
    scatter: np.ndarray
    law: np.ndarray


class StepDetector:
    """
    Finds steps of mounts in the offsets of heads, the first of which is the reference.

    The difference of two heads has no error of the attitude. Over the last WINDOW_S it is fitted
    by a parabola, for slow bending, and by the law of the mount, with and without a step at the
    border of two blocks: the generalised likelihood ratio is the chi-square of the step.
    """

    def __init__(self, heads: tuple[str, ...]) -> None:
        self._reference = heads[0]
        self._block: dict[str, _Block] = {}
        self._number: int | None = None
        self._series: dict[str, deque[_Difference]] = {
            head: deque(maxlen=int(WINDOW_S / BLOCK_S)) for head in heads[1:]}

    def add(self, head: str, stamp_ns: int, offset_rad: np.ndarray, variance_rad2: np.ndarray,
            law: np.ndarray) -> list[MountStep]:
        """
        Add the attitude (3,) of a head minus that of the state; return the steps found now.

        variance_rad2 (3,) is that of the offset, law (L,) are the phi of the mount but the 1.
        """
        number, found = stamp_ns // int(BLOCK_S * 1e9), []
        if self._number is None or number > self._number:
            found = self._close()
            self._block, self._number = {}, number
        if number == self._number:
            self._block.setdefault(head, _Block()).add(offset_rad, variance_rad2, law)
        return found

    def _close(self) -> list[MountStep]:
        """Add the differences of the block to their series and look for steps."""
        reference, found = self._block.get(self._reference), []
        if self._number is None or reference is None or reference.count < _LEAST_FRAMES:
            return []
        mean, variance, scatter = reference.mean()
        for head, series in self._series.items():
            block = self._block.get(head)
            if block is None or block.count < _LEAST_FRAMES:
                continue
            own_mean, own_variance, own_scatter = block.mean()
            series.append(_Difference(self._number, own_mean - mean, own_variance + variance,
                                      own_scatter + scatter, block.law))
            while (self._number - series[0].number) * BLOCK_S > WINDOW_S:
                series.popleft()
            step = _step(head, list(series))
            if step is not None:
                found.append(step)
                # What comes next is compared with what is after the step.
                after = [entry for entry in series
                         if entry.number * BLOCK_S >= step.stamp_ns * 1e-9]
                series.clear()
                series.extend(after)
        return found


def _step(head: str, series: list[_Difference]) -> MountStep | None:
    """Return the most significant step of a series, if any."""
    candidates = np.arange(_LEAST_BEFORE, len(series))
    if len(candidates) < _LEAST_AFTER:
        return None
    number, difference, variance, scatter, law = map(np.array, zip(*series))
    # The mean over the window: the scatter within a block is a poor measure of few frames.
    variance = variance * np.maximum(np.mean(scatter / variance, axis=0), _LEAST_SCATTER)
    time = (number - number[0]) / max(number[-1] - number[0], 1)
    smooth = np.column_stack([np.vander(time, 3), law])
    steps = (np.arange(len(series))[:, None] >= candidates).astype(float)
    size, square = np.empty((2, len(candidates), 3))
    for axis in range(3):
        weight = 1 / np.sqrt(variance[:, axis, None])
        basis, strength, _ = np.linalg.svd(weight * smooth, full_matrices=False)
        # A law that does not vary in the window has no column of its own.
        basis = basis[:, strength > _LEAST_STRENGTH * strength[0]]
        weighted = weight * steps
        weighted -= basis @ (basis.T @ weighted)
        square[:, axis] = np.maximum(np.sum(weighted * weighted, axis=0), 1e-30)
        size[:, axis] = weighted.T @ (weight[:, 0] * difference[:, axis]) / square[:, axis]
    chi_square = np.sum(size ** 2 * square, axis=1)
    best = int(np.argmax(chi_square))
    if best > len(candidates) - _LEAST_AFTER:
        # Too new to be dated.
        return None
    if chi_square[best] < _THRESHOLD or np.linalg.norm(size[best]) < _LEAST_RAD:
        return None
    return MountStep(head, int(number[candidates[best]] * BLOCK_S * 1e9), size[best],
                     1 / np.sqrt(square[best]))
