"""From a star image to centroids, with a reason for everything left out."""

from dataclasses import dataclass, field, replace
import math
from statistics import median

import numpy as np
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.detection import Peaks
from startracker_ros.centroid.frame import Frame, prepare
from startracker_ros.centroid.gaussian_fit import Fit, fit_stars
from startracker_ros.centroid.moments import Segmentation, weighted_means, WEIGHTS
from startracker_ros.centroid.noise import first_noise_model
from startracker_ros.centroid.noise_fit import refine_noise_model
from startracker_ros.centroid.psf import FLUX, SIGMA, U, V
from startracker_ros.centroid.shape import judge_shape, lone_pixels, repeated, streaks
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled
from startracker_ros.options import option, Options

MIN_SIDE_PX = 8
FILTER_SIGMA_PX = 1.0  # while the width of the stars is unknown
FILTER_RATIO = 2.0  # a filter wrong by more than this is made anew
FILTER_RANGE_PX = (0.5, 5.0)
PX_PER_PEAK = 400  # more peaks than one in so many pixels are noise, not stars
FEW_PEAKS = 100  # never too many
SPARE_PEAKS = 2  # fitted per star wanted, as some will be rejected
WIDTH_STARS = 10  # fitted at a time, brightest first
WIDTH_BATCHES = 6
WIDTH_ENOUGH = 3  # stars that agree on a width
WIDTH_ERROR = 0.25  # relative, of a star that may tell the width
ROUGH_ITERATIONS = 2
WIDTH_ITERATIONS = 4
EDGE_SIGMAS = 1.5
CORE_RADIUS_PX = 2
CORE_SATURATED_PX = 9  # saturated pixels of a star that its flanks can still place
MOVED_PX = 1.5  # a fit that ends further from its peak is of something else
APART_PX = 1.0  # two fits closer than this are one star
FAINT = 0.85  # of the threshold: the fit also frees place and level, so its snr is lower
MISFIT = 3.0  # standard deviations of chi2 beyond which it widens the errors


@dataclass(frozen=True)
class ExtractionOptions(Options):
    """Options of the centroid extraction."""

    threshold: str = option(
        'sigma', 'which pixels belong to a star: more than 3 times their noise, threshold_dn '
        '(which is then that of detection, too), or the iterative threshold of its window',
        choices=('sigma', 'fixed', 'iterative'))
    threshold_sigma: float = option(
        5.5, 'detection threshold above the local background, in noise of the filtered image',
        low=3.0, high=100.0)
    threshold_dn: float = option(
        50.0, 'fixed detection threshold above the local background', unit='DN', low=0.1,
        high=65535.0)
    method: str = option(
        'gaussian', 'fit of the point spread function, or mean of the pixels of a star weighed '
        'alike, by light, by its square, by what exceeds the threshold',
        choices=(*WEIGHTS, 'gaussian'))
    psf_sigma_px: float = option(
        0.0, 'width (1 sigma) of a star image, 0: estimated from each image',
        unit='px', low=0.0, high=5.0)
    max_stars: int = option(
        40, 'most stars returned, the brightest', low=1, high=5000)


@dataclass(frozen=True)
class Extraction:
    """
    Centroids of an image and how they came about.

    status is 'ok', 'no_stars', 'blank', 'saturated', 'too_small' or 'too_many', and reason says
    why in words, empty when ok. background_dn and noise_dn (1 sigma of a pixel) are medians
    over the image, psf_sigma_px the width fitted with; NaN where not measured. rejected
    counts the spots left out, by reason.
    """

    centroids: Centroids
    status: str
    reason: str
    background_dn: float = float('nan')
    noise_dn: float = float('nan')
    psf_sigma_px: float = float('nan')
    rejected: dict[str, int] = field(default_factory=dict)


class CentroidExtractor:
    """Finds the stars of mono8 and mono16 images; a pure function of image and options."""

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 factor: float = 1.0) -> None:
        """Prepare; a factor makes the threshold of the weighted means a wrong one."""
        self._options = options
        self._factor = factor

    def extract(self, image: np.ndarray) -> Extraction:
        """Return the stars of image (H, W) uint8 or uint16; ValueError for anything else."""
        _check(image)
        height, width = image.shape
        if min(height, width) < MIN_SIDE_PX:
            return _none('too_small', f'image of {width} x {height} px, '
                         f'at least {MIN_SIDE_PX} px a side are needed')
        # Compiled for one layout, read-only, which images out of DDS are: padded rows are copied.
        image = np.require(image, requirements=['C', 'A']).view()
        image.flags.writeable = False
        most = max(FEW_PEAKS, image.size // PX_PER_PEAK)
        fixed = self._options.threshold == 'fixed'
        threshold = ((0.0, self._options.threshold_dn) if fixed
                     else (self._options.threshold_sigma, 0.0))
        sigma_px = self._options.psf_sigma_px
        frame = prepare(image, sigma_px or FILTER_SIGMA_PX, *threshold, most)
        if frame.blank:
            return _none('blank', f'all pixels are {image[0, 0]} DN')
        if frame.saturated:
            return _none('saturated', f'most pixels are at full scale, {frame.full_scale_dn:g} DN',
                         frame)
        if not sigma_px and 0 < frame.search.found <= most:
            sigma_px = measure_width(frame)
            if not 1 / FILTER_RATIO < sigma_px / FILTER_SIGMA_PX < FILTER_RATIO:
                filter_sigma_px = float(np.clip(sigma_px, *FILTER_RANGE_PX))
                frame = prepare(image, filter_sigma_px, *threshold, most)
                sigma_px = measure_width(frame)
        peaks, count, discs = frame.search[:3]
        if not count:
            return _none('no_stars', f'nothing like a star above {_words(*threshold)}', frame,
                         {'disc': discs} if discs else {})
        if count > most:
            return _none('too_many', f'{count} spots: noise, not stars', frame)
        centroids, rejected = self._measure(frame, peaks, sigma_px, *threshold)
        if discs:
            rejected['disc'] = discs
        return Extraction(
            centroids, *(('ok', '') if len(centroids) else ('no_stars', 'no spot is a star')),
            frame.background_dn, frame.noise_dn, sigma_px, rejected)

    def warm_up(self) -> None:
        """Compile what is used, or load it, so that the first image need not wait for it."""
        rng = np.random.default_rng(1)
        image = rng.normal(50, 3, (64, 64))
        for u, v in ((15, 20), (50, 15), (30, 45)):
            image[v - 1:v + 2, u - 1:u + 2] += np.outer((40, 80, 40), (1, 2, 1))
        for kind in (np.uint8, np.uint16):
            self.extract(image.clip(0, 255).astype(kind))

    def _measure(self, frame: Frame, peaks: Peaks, sigma_px: float, sigmas: float,
                 least_dn: float) -> tuple[Centroids, dict[str, int]]:
        """
        Fit stars of this width to peaks; return the good ones, count the others.

        sigmas and least_dn are the threshold.
        """
        rejected: dict[str, int] = {}

        def reject(**reasons: np.ndarray) -> np.ndarray:
            """Count each spot under the first of its reasons; return those without any."""
            bad = np.zeros(len(next(iter(reasons.values()))), bool)
            for reason, spots in reasons.items():
                if np.count_nonzero(spots):
                    count = int(np.count_nonzero(spots & ~bad))
                    if count:
                        rejected[reason] = rejected.get(reason, 0) + count
                    bad |= spots
            return ~bad

        peaks = peaks.select(slice(SPARE_PEAKS * self._options.max_stars))
        windows, start = frame.windows(peaks, sigma_px)
        (height, width), (u, v) = frame.image.shape, peaks.uv.T
        border = np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))
        keep = reject(edge=border < np.ceil(EDGE_SIGMAS * sigma_px),
                      saturated=_core_saturated(windows) > CORE_SATURATED_PX)
        windows, start = windows.select(keep), start[keep]

        noise = first_noise_model(frame.background_dn, frame.noise_dn ** 2)
        fit = fit_stars(windows, start, noise, iterations=ROUGH_ITERATIONS)
        shape = judge_shape(fit, windows)
        keep = reject(hot_pixel=shape.narrow & lone_pixels(windows.data), cosmic_ray=shape.narrow,
                      elongated=shape.elongated, too_wide=shape.wide,
                      not_fitted=_moved(fit, windows))
        noise = refine_noise_model(noise, fit, windows, keep & (_core_saturated(windows) == 0))
        windows, start = windows.select(keep), fit.parameters[keep]

        fit = fit_stars(windows, start, noise)
        centroids = _centroids(fit)
        keep = reject(not_fitted=_moved(fit, windows) | repeated(fit, windows, APART_PX),
                      faint=_significance(fit) < FAINT * sigmas)
        if self._options.method != 'gaussian':
            uv, error_px = weighted_means(
                self._options.method, windows, fit, noise,
                Segmentation(least_dn, self._options.threshold == 'iterative', self._factor))
            centroids = replace(centroids, uv=uv, sigma_px=error_px)
            keep &= reject(faint=keep & ~np.isfinite(uv[:, 0]))
        order = np.argsort(-centroids.flux, kind='stable')
        return centroids.select(order[keep[order]][:self._options.max_stars]), rejected


def measure_width(frame: Frame) -> float:
    """
    Return the median width (1 sigma, px) of the brightest stars.

    Where no spot tells, the width of the filter that found them is returned.
    """
    told, peaks = [], frame.search.peaks
    for first in range(0, min(len(peaks.uv), WIDTH_BATCHES * WIDTH_STARS), WIDTH_STARS):
        told += _widths(frame, peaks.select(slice(first, first + WIDTH_STARS))).tolist()
        if len(told) >= WIDTH_ENOUGH:
            break
    return median(told) if told else frame.kernel.sigma_px


def _widths(frame: Frame, peaks: Peaks) -> np.ndarray:
    """Return the widths of those peaks that look like unsaturated stars."""
    windows, start = frame.windows(peaks, frame.kernel.sigma_px)
    chosen = (_core_saturated(windows) == 0) & ~lone_pixels(windows.data)
    windows, start = windows.select(chosen), start[chosen]
    noise = first_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, free_sigma=True, iterations=WIDTH_ITERATIONS)
    width = fit.parameters[:, SIGMA]
    error = np.sqrt(fit.covariance[:, SIGMA, SIGMA])
    return width[(error < WIDTH_ERROR * width) & ~_moved(fit, windows)
                 & ~streaks(fit, windows)]


def _check(image: np.ndarray) -> None:
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f'image is {kind}, must be uint8 or uint16')
    if image.ndim != 2:
        raise ValueError(f'image has {image.ndim} dimensions, must have 2 (grey)')
    if not image.size:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px is empty')


def _words(sigmas: float, least_dn: float) -> str:
    return f'{least_dn:.1f} DN' if least_dn > 0 else f'{sigmas:g} sigma'


def _none(status: str, reason: str, frame: Frame | None = None,
          rejected: dict[str, int] | None = None) -> Extraction:
    if frame is None:
        return Extraction(Centroids.empty(), status, reason, rejected=rejected or {})
    return Extraction(Centroids.empty(), status, reason, frame.background_dn, frame.noise_dn,
                      rejected=rejected or {})


def _core_saturated(windows: Windows) -> np.ndarray:
    """Return the number (K,) of unused pixels around the peaks."""
    return _unused(windows.used, CORE_RADIUS_PX)


@compiled
def _unused(used: np.ndarray, radius: int) -> np.ndarray:
    """Return the number (K,) of pixels not used within radius of the middle of used (K, n, n)."""
    middle, count = used.shape[1] // 2, np.zeros(len(used), np.int64)
    for i in range(len(used)):
        for y in range(middle - radius, middle + radius + 1):
            for x in range(middle - radius, middle + radius + 1):
                count[i] += not used[i, y, x]
    return count


def _moved(fit: Fit, windows: Windows) -> np.ndarray:
    """Return whether (K,) the fits are far from their peaks, or nowhere."""
    return _far(fit.parameters, windows.corner, windows.radius)


@compiled
def _far(parameters: np.ndarray, corner: np.ndarray, radius: int) -> np.ndarray:
    far = np.empty(len(corner), np.bool_)
    for i in range(len(corner)):
        far[i] = not (math.hypot(parameters[i, U] - corner[i, 0] - radius,
                                 parameters[i, V] - corner[i, 1] - radius) < MOVED_PX)
    return far


def _significance(fit: Fit) -> np.ndarray:
    """Return flux (K,) over its error by the noise model alone."""
    return fit.parameters[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX])


def _centroids(fit: Fit) -> Centroids:
    """Return all fitted stars; a misfit beyond chance widens their errors."""
    ratio = fit.chi2 / fit.dof
    misfit = np.where(ratio > 1 + MISFIT * np.sqrt(2 / fit.dof), np.sqrt(ratio), 1.0)
    place = fit.covariance[:, U, U] + fit.covariance[:, V, V]
    return Centroids(fit.parameters[:, :V + 1], fit.parameters[:, FLUX],
                     _significance(fit) / misfit, misfit * np.sqrt(place / 2))
