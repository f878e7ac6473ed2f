"""Width of the star images of a frame."""

from statistics import median

import numpy as np
from startracker_ros.centroid.detection import Peaks
from startracker_ros.centroid.frame import Frame
from startracker_ros.centroid.gaussian_fit import fit_stars
from startracker_ros.centroid.noise import initial_noise_model
from startracker_ros.centroid.position import drifted
from startracker_ros.centroid.psf import SIGMA
from startracker_ros.centroid.shape import lone_pixels, streaks

BATCH = 10  # peaks fitted at a time, brightest first
MAX_BATCHES = 6
ENOUGH_STARS = 3  # whose median is the width
MAX_ERROR = 0.25  # relative, of the width of a star that counts
ITERATIONS = 4


def measure_width(frame: Frame) -> float:
    """
    Return the median width (1 sigma, px) of the brightest stars.

    Without a star that counts it is the width of the filter that found the peaks.
    """
    widths, peaks = [], frame.search.peaks
    for first in range(0, min(len(peaks.uv), MAX_BATCHES * BATCH), BATCH):
        widths += _widths(frame, peaks.select(slice(first, first + BATCH))).tolist()
        if len(widths) >= ENOUGH_STARS:
            break
    return median(widths) if widths else frame.kernel.sigma_px


def _widths(frame: Frame, peaks: Peaks) -> np.ndarray:
    """Return the widths of those peaks that look like unsaturated stars."""
    windows, start = frame.windows(peaks, frame.kernel.sigma_px)
    chosen = (windows.saturated_cores() == 0) & ~lone_pixels(windows.data)
    windows, start = windows.select(chosen), start[chosen]
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, free_sigma=True, iterations=ITERATIONS)
    width = fit.parameters[:, SIGMA]
    error = np.sqrt(fit.covariance[:, SIGMA, SIGMA])
    return width[(error < MAX_ERROR * width) & ~drifted(fit, windows) & ~streaks(fit, windows)]
