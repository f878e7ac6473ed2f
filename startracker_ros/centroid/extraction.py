"""From a star image to centroids, with a reason for everything left out."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.frame import Frame, prepare
from startracker_ros.centroid.gaussian_fit import Fit, fit_stars, FLUX, SIGMA, U, V
from startracker_ros.centroid.noise import first_noise_model, NoiseModel, refine_noise_model
from startracker_ros.centroid.shape import elongated, too_narrow, too_wide
from startracker_ros.centroid.windows import Windows
from startracker_ros.options import option, Options

MIN_SIDE_PX = 8
FILTER_SIGMA_PX = 1.0  # while the width of the stars is unknown
FILTER_RATIO = 2.0  # a filter wrong by more than this is made anew
FILTER_RANGE_PX = (0.5, 5.0)
PX_PER_PEAK = 400  # more peaks than one in so many pixels are noise, not stars
FEW_PEAKS = 100  # never too many
SPARE_PEAKS = 2  # fitted per star wanted, as some will be rejected
WIDTH_STARS = 16  # fitted at a time, brightest first
WIDTH_BATCHES = 4
WIDTH_ENOUGH = 3  # stars that agree on a width
WIDTH_ERROR = 0.25  # relative, of a star that may tell the width
LONE_PIXEL = 0.3  # less light than this share of a pixel in the eight around it: not a star
ROUGH_ITERATIONS = 3
WIDTH_ITERATIONS = 6
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

    threshold_sigma: float = option(
        5.5, 'detection threshold above the local background, in noise of the filtered image',
        low=3.0, high=100.0)
    psf_sigma_px: float = option(
        0.0, 'width (1 sigma) of a star image, 0: estimated from each image',
        unit='px', low=0.0, high=5.0)
    max_stars: int = option(
        40, 'most stars returned, the brightest', low=1, high=5000)


@dataclass(frozen=True)
class Extraction:
    """Centroids of an image and how they came about.

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

    def __init__(self, options: ExtractionOptions = ExtractionOptions()) -> None:
        self._options = options

    def extract(self, image: np.ndarray) -> Extraction:
        """Return the stars of image (H, W) uint8 or uint16; ValueError for anything else."""
        _check(image)
        height, width = image.shape
        if min(height, width) < MIN_SIDE_PX:
            return _none('too_small', f'image of {width} x {height} px, '
                         f'at least {MIN_SIDE_PX} px a side are needed')
        if image.min() == image.max():
            return _none('blank', f'all pixels are {image[0, 0]} DN')
        frame = prepare(image, self._options.psf_sigma_px or FILTER_SIGMA_PX)
        if np.isfinite(frame.full_scale_dn) and (
                2 * np.count_nonzero(image == frame.full_scale_dn) > image.size):
            return _none('saturated', f'most pixels are at full scale, {frame.full_scale_dn:g} DN',
                         frame)
        peaks, discs = frame.peaks(self._options.threshold_sigma)
        sigma_px = self._options.psf_sigma_px
        if not sigma_px and 0 < len(peaks) <= _most_peaks(image):
            sigma_px = measure_width(frame, peaks)
            if not 1 / FILTER_RATIO < sigma_px / FILTER_SIGMA_PX < FILTER_RATIO:
                frame = prepare(image, float(np.clip(sigma_px, *FILTER_RANGE_PX)))
                peaks, discs = frame.peaks(self._options.threshold_sigma)
                sigma_px = measure_width(frame, peaks)
        if not len(peaks):
            return _none('no_stars', 'nothing like a star above '
                         f'{self._options.threshold_sigma:g} sigma', frame,
                         {'disc': discs} if discs else {})
        if len(peaks) > _most_peaks(image):
            return _none('too_many', f'{len(peaks)} spots: noise, not stars', frame)
        centroids, rejected = self._measure(frame, peaks, sigma_px)
        if discs:
            rejected['disc'] = discs
        return Extraction(
            centroids, *(('ok', '') if len(centroids) else ('no_stars', 'no spot is a star')),
            frame.background_dn, frame.noise_dn, sigma_px, rejected)

    def _measure(self, frame: Frame, peaks: np.ndarray, sigma_px: float
                 ) -> tuple[Centroids, dict[str, int]]:
        """Fit stars of this width to peaks (N, 2); return the good ones, count the others."""
        rejected: dict[str, int] = {}

        def reject(**reasons: np.ndarray) -> np.ndarray:
            """Count each spot under the first of its reasons; return those without any."""
            bad = np.zeros(len(next(iter(reasons.values()))), bool)
            for reason, spots in reasons.items():
                count = int((spots & ~bad).sum())
                if count:
                    rejected[reason] = rejected.get(reason, 0) + count
                bad |= spots
            return ~bad

        peaks = peaks[:SPARE_PEAKS * self._options.max_stars]
        windows, start = frame.windows(peaks, sigma_px)
        border = np.minimum(peaks, np.array(frame.pixels.shape[::-1]) - 1 - peaks).min(1)
        keep = reject(edge=border < np.ceil(EDGE_SIGMAS * sigma_px),
                      saturated=_core_saturated(windows) > CORE_SATURATED_PX)
        windows, start = windows.select(keep), start[keep]

        noise = first_noise_model(frame.background_dn, frame.noise_dn ** 2)
        fit = fit_stars(windows, start, noise, iterations=ROUGH_ITERATIONS)
        keep = reject(too_narrow=too_narrow(fit, windows), elongated=elongated(fit, windows),
                      too_wide=too_wide(fit, windows), not_fitted=_moved(fit, windows))
        noise = _refined_noise(noise, fit, windows, keep & (_core_saturated(windows) == 0))
        windows, start = windows.select(keep), fit.parameters[keep]

        fit = fit_stars(windows, start, noise)
        centroids = _centroids(fit)
        keep = reject(not_fitted=_moved(fit, windows) | _repeated(centroids),
                      faint=_significance(fit) < FAINT * self._options.threshold_sigma)
        order = np.argsort(-centroids.flux, kind='stable')
        chosen = order[keep[order]][:self._options.max_stars]
        return Centroids(centroids.uv[chosen], centroids.flux[chosen], centroids.snr[chosen],
                         centroids.sigma_px[chosen]), rejected


def measure_width(frame: Frame, peaks: np.ndarray) -> float:
    """Return the median width (1 sigma, px) of the brightest stars among peaks (N, 2).

    Where no spot tells, the width of the filter that found them is returned.
    """
    told = np.empty(0)
    for first in range(0, min(len(peaks), WIDTH_BATCHES * WIDTH_STARS), WIDTH_STARS):
        told = np.append(told, _widths(frame, peaks[first:first + WIDTH_STARS]))
        if len(told) >= WIDTH_ENOUGH:
            break
    return float(np.median(told)) if len(told) else frame.filter_sigma_px


def _widths(frame: Frame, peaks: np.ndarray) -> np.ndarray:
    """Return the widths of those peaks that look like unsaturated stars."""
    windows, start = frame.windows(peaks, frame.filter_sigma_px)
    middle = windows.radius
    centre = windows.data[:, middle, middle]
    around = windows.data[:, middle - 1:middle + 2, middle - 1:middle + 2].sum((1, 2)) - centre
    chosen = (_core_saturated(windows) == 0) & (around > LONE_PIXEL * centre)
    windows, start = windows.select(chosen), start[chosen]
    noise = first_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, free_sigma=True, iterations=WIDTH_ITERATIONS)
    width = fit.parameters[:, SIGMA]
    error = np.sqrt(fit.covariance[:, SIGMA, SIGMA])
    return width[(error < WIDTH_ERROR * width) & ~_moved(fit, windows)
                 & ~elongated(fit, windows)]


def _check(image: np.ndarray) -> None:
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f'image is {kind}, must be uint8 or uint16')
    if image.ndim != 2:
        raise ValueError(f'image has {image.ndim} dimensions, must have 2 (grey)')
    if not image.size:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px is empty')


def _none(status: str, reason: str, frame: Frame | None = None,
          rejected: dict[str, int] | None = None) -> Extraction:
    known = (frame.background_dn, frame.noise_dn) if frame else ()
    return Extraction(Centroids.empty(), status, reason, *known, rejected=rejected or {})


def _most_peaks(image: np.ndarray) -> int:
    return max(FEW_PEAKS, image.size // PX_PER_PEAK)


def _core_saturated(windows: Windows) -> np.ndarray:
    """Return the number (K,) of unused pixels around the peaks."""
    low, high = windows.radius - CORE_RADIUS_PX, windows.radius + CORE_RADIUS_PX + 1
    return (~windows.used[:, low:high, low:high]).sum((1, 2))


def _moved(fit: Fit, windows: Windows) -> np.ndarray:
    way = fit.parameters[:, [U, V]] - windows.corner - windows.radius
    return ~(np.hypot(*way.T) < MOVED_PX)


def _significance(fit: Fit) -> np.ndarray:
    """Return flux (K,) over its error by the noise model alone."""
    return fit.parameters[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX])


def _repeated(centroids: Centroids) -> np.ndarray:
    """Return True (K,) for the fainter of two fits of one star."""
    repeated = np.zeros(len(centroids), bool)
    for i, j in cKDTree(centroids.uv).query_pairs(APART_PX):
        repeated[i if centroids.flux[i] < centroids.flux[j] else j] = True
    return repeated


def _refined_noise(noise: NoiseModel, fit: Fit, windows: Windows,
                   chosen: np.ndarray) -> NoiseModel:
    used = windows.used & chosen[:, None, None]
    background = np.broadcast_to(windows.variance[:, None, None], used.shape)
    return refine_noise_model(noise, (fit.own - fit.light)[used], fit.light[used],
                              background[used], np.maximum(1 - fit.leverage[used], 0.1))


def _centroids(fit: Fit) -> Centroids:
    """Return all fitted stars; a misfit beyond chance widens their errors."""
    ratio = fit.chi2 / fit.freedom
    misfit = np.where(ratio > 1 + MISFIT * np.sqrt(2 / fit.freedom), np.sqrt(ratio), 1.0)
    place = fit.covariance[:, U, U] + fit.covariance[:, V, V]
    return Centroids(fit.parameters[:, [U, V]], fit.parameters[:, FLUX],
                     _significance(fit) / misfit, misfit * np.sqrt(place / 2))
