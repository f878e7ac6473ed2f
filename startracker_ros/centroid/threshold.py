"""The iterative threshold of an image (Gao and Cui 2016)."""

import numpy as np

from startracker_ros.compiled import compiled

_ENOUGH_DN = 0.1
_ROUNDS = 100


@compiled
def iterative_threshold(image):
    """Return the DN that is the mean of the means of the pixels of image (H, W) beside it.

    It begins between the darkest and the brightest pixel. Pixels at the threshold count as
    bright. An image of one value has no other threshold.
    """
    threshold = (np.float64(image.min()) + np.float64(image.max())) / 2
    for _ in range(_ROUNDS):
        bright = total = bright_total = 0
        for v in range(image.shape[0]):
            for u in range(image.shape[1]):
                value = int(image[v, u])
                above = value >= threshold
                bright, total = bright + above, total + value
                bright_total += value * above
        if bright in (0, image.size):
            break
        before = threshold
        threshold = (bright_total / bright
                     + (total - bright_total) / (image.size - bright)) / 2
        if abs(threshold - before) < _ENOUGH_DN:
            break
    return threshold
