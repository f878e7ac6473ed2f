"""Steps of mounts: one head's attitude against the reference's, before and after a time."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from startracker_ros.maths.rotation import ARCSEC

BLOCK_S = 10.0
WINDOW_S = 900.0

_LEAST_FRAMES = 3  # of each head in a block
_LEAST_BEFORE, _LEAST_AFTER = 12, 6  # blocks
_THRESHOLD = 50.0
"""Chi-square of a step about three axes: chance exceeds it in one of 1e10 blocks."""

_LEAST_RAD = 2 * ARCSEC  # faster bending than the law of the window is no step


@dataclass(frozen=True)
class MountStep:
    """A step of a mount against the reference: size (3,) rad about body axes, 1 sigma (3,)."""

    head: str
    stamp_ns: int
    size_rad: np.ndarray
    sigma_rad: np.ndarray


class _Block:
    """Sums of the offsets of one head over BLOCK_S."""

    def __init__(self) -> None:
        self.count, self.total, self.squares = 0, np.zeros(3), np.zeros(3)

    def add(self, offset_rad: np.ndarray) -> None:
        self.count += 1
        self.total += offset_rad
        self.squares += offset_rad * offset_rad

    def mean(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the average (3,) and its variance (3,) by the scatter of the frames."""
        mean = self.total / self.count
        scatter = (self.squares - self.count * mean * mean) / (self.count - 1)
        return mean, np.maximum(scatter, (0.01 * ARCSEC) ** 2) / self.count


class StepDetector:
    """
    Finds steps of mounts in the offsets of heads, the first of which is the reference.

    The difference of two heads has no error of the attitude. Over the last WINDOW_S it is fitted
    by a parabola, for slow bending, with and without a step at the border of two blocks: the
    generalised likelihood ratio is the chi-square of the step.
    """

    def __init__(self, heads: tuple[str, ...]) -> None:
        self._reference = heads[0]
        self._block: dict[str, _Block] = {}
        self._number: int | None = None
        self._series: dict[str, deque[tuple[int, np.ndarray, np.ndarray]]] = {
            head: deque(maxlen=int(WINDOW_S / BLOCK_S)) for head in heads[1:]}

    def add(self, head: str, stamp_ns: int, offset_rad: np.ndarray) -> list[MountStep]:
        """Add the attitude (3,) of a head minus that of the state; return the steps found now."""
        number, found = stamp_ns // int(BLOCK_S * 1e9), []
        if self._number is None or number > self._number:
            found = self._close()
            self._block, self._number = {}, number
        if number == self._number:
            self._block.setdefault(head, _Block()).add(offset_rad)
        return found

    def _close(self) -> list[MountStep]:
        """Add the differences of the block to their series and look for steps."""
        reference, found = self._block.get(self._reference), []
        if self._number is None or reference is None or reference.count < _LEAST_FRAMES:
            return []
        mean, variance = reference.mean()
        for head, series in self._series.items():
            block = self._block.get(head)
            if block is None or block.count < _LEAST_FRAMES:
                continue
            own_mean, own_variance = block.mean()
            series.append((self._number, own_mean - mean, own_variance + variance))
            while (self._number - series[0][0]) * BLOCK_S > WINDOW_S:
                series.popleft()
            step = _step(head, list(series))
            if step is not None:
                found.append(step)
                # What comes next is compared with what is after the step.
                after = [entry for entry in series
                         if entry[0] * BLOCK_S >= step.stamp_ns * 1e-9]
                series.clear()
                series.extend(after)
        return found


def _step(head: str, series: list[tuple[int, np.ndarray, np.ndarray]]) -> MountStep | None:
    """Return the most significant step of a series of block, difference and variance, if any."""
    candidates = np.arange(_LEAST_BEFORE, len(series))
    if len(candidates) < _LEAST_AFTER:
        return None
    number = np.array([entry[0] for entry in series])
    difference = np.array([entry[1] for entry in series])
    # The mean over the window: the scatter within a block is a poor measure of few frames.
    sigma = np.sqrt(np.mean([entry[2] for entry in series], axis=0))
    time = (number - number[0]) / max(number[-1] - number[0], 1)
    basis = np.linalg.qr(np.vander(time, 3))[0]
    steps = (np.arange(len(series))[:, None] >= candidates).astype(float)
    steps -= basis @ (basis.T @ steps)
    residual = difference - basis @ (basis.T @ difference)
    square = np.sum(steps * steps, axis=0)
    size = steps.T @ residual / square[:, None]
    chi_square = np.sum((size / sigma) ** 2, axis=1) * square
    best = int(np.argmax(chi_square))
    if best > len(candidates) - _LEAST_AFTER:
        # Too new to be dated.
        return None
    if chi_square[best] < _THRESHOLD or np.linalg.norm(size[best]) < _LEAST_RAD:
        return None
    return MountStep(head, int(number[candidates[best]] * BLOCK_S * 1e9), size[best],
                     sigma / np.sqrt(square[best]))
