"""The iterative threshold of the window of a star (Gao and Cui 2016)."""

import numpy as np
from startracker_ros.core.compiled import compiled

_CONVERGED = 1e-3  # of the range of the window
_MAX_ITERATIONS = 30


@compiled
def iterative_threshold(window: np.ndarray) -> float:
    """
    Return the value that is the mean of the means of the pixels of (n, n) below and above it.

    The iteration starts halfway between the darkest and the brightest pixel.
    """
    low, high = window.min(), window.max()
    threshold = (low + high) / 2
    for _ in range(_MAX_ITERATIONS):
        bright, total, bright_total = 0, 0.0, 0.0
        for y in range(window.shape[0]):
            for x in range(window.shape[1]):
                total += window[y, x]
                if window[y, x] >= threshold:
                    bright, bright_total = bright + 1, bright_total + window[y, x]
        if bright == 0 or bright == window.size:
            break
        before = threshold
        threshold = (bright_total / bright
                     + (total - bright_total) / (window.size - bright)) / 2
        if abs(threshold - before) < _CONVERGED * (high - low):
            break
    return threshold
