"""Where stars may be: peaks of the smoothed image, and the full scale of the camera."""

import cv2
import numpy as np

PLATEAU_DN = 64  # a flat top lower than this may be rounding, not saturation
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def smooth_image(image: np.ndarray, sigma_px: float) -> tuple[np.ndarray, float]:
    """Return image (H, W) filtered by a Gaussian, float32, and the gain on white noise.

    A Gaussian of the width of the point spread function is the matched filter of stars;
    with a width wrong by a factor q it keeps 2 q / (1 + q^2) of the signal to noise ratio.
    """
    radius = np.ceil(2 * sigma_px)
    x = np.arange(-radius, radius + 1)
    kernel = np.exp(-0.5 * (x / sigma_px) ** 2)
    kernel /= kernel.sum()
    smooth = cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel,
                             borderType=cv2.BORDER_REFLECT_101)
    return smooth, float((kernel ** 2).sum())


def find_peaks(smooth: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    """Return the local maxima of smooth above threshold, both (H, W), as (N, 2) int u, v.

    A pixel must exceed the four neighbours before it and not fall below the four after
    it, so that a flat top gives one peak. The outermost pixels are no peaks.
    """
    height, width = smooth.shape
    above = cv2.compare(smooth, threshold, cv2.CMP_GT).view(bool)
    above[[0, -1]] = above[:, [0, -1]] = False
    place, flat = np.flatnonzero(above), smooth.ravel()
    for step in (1, width - 1, width, width + 1):
        place = place[(flat[place] > flat[place - step]) & (flat[place] >= flat[place + step])]
    return np.stack([place % width, place // width], 1)


def full_scale(image: np.ndarray, background_dn: float) -> float:
    """Return the DN at which the image saturates, infinity when nothing in it is saturated.

    The brightest pixel is at full scale when it has the largest value of the type or of a
    10, 12 or 14 bit camera (in the low or the high bits), or when it belongs to a flat top,
    as it does where a camera clips at a level of its own.
    """
    brightest, bits = int(image.max()), 8 * image.dtype.itemsize
    if brightest == 2 ** bits - 1:
        return float(brightest)
    if brightest - background_dn < PLATEAU_DN:
        return np.inf
    depths = (10, 12, 14) if bits == 16 else ()
    if any(brightest in (2 ** depth - 1, (2 ** depth - 1) << (bits - depth))
           for depth in depths):
        return float(brightest)
    top = cv2.compare(image, float(brightest), cv2.CMP_EQ)
    flat = cv2.countNonZero(top) >= cv2.countNonZero(_CROSS) and cv2.hasNonZero(
        cv2.erode(top, _CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=0))
    return float(brightest) if flat else np.inf
