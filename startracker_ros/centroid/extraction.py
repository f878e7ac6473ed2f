"""
Star image to centroids, with a reason for every spot left out.

1. Background and peaks of the image (frame.py), after a matched filter.
2. Width of the stars (width.py); if the filter does not match, step 1 once more.
3. Rough fit of the brightest peaks: shapes that are no stars are rejected, the rest give the
   noise model.
4. Final fit: centroids with covariance, or weighted means instead of the fitted positions.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.detection import Peaks, Threshold
from startracker_ros.centroid.frame import Frame, prepare
from startracker_ros.centroid.gaussian_fit import Fit, fit_stars
from startracker_ros.centroid.moments import Segmentation, weighted_means, WEIGHTS
from startracker_ros.centroid.noise import initial_noise_model, NoiseModel
from startracker_ros.centroid.noise_fit import refine_noise_model
from startracker_ros.centroid.position import drifted, duplicates
from startracker_ros.centroid.psf import FLUX, U, V
from startracker_ros.centroid.rejection import Rejections
from startracker_ros.centroid.shape import classify_shapes, lone_pixels
from startracker_ros.centroid.width import measure_width
from startracker_ros.centroid.windows import Windows
from startracker_ros.options import option, Options

MIN_SIDE_PX = 8
FILTER_SIGMA_PX = 1.0  # while the width of the stars is unknown
FILTER_RATIO = 2.0  # a filter wrong by more than this factor is replaced
FILTER_RANGE_PX = (0.5, 5.0)
SPARE_PEAKS = 2  # peaks fitted per star wanted, as some will be rejected
ROUGH_ITERATIONS = 2
EDGE_SIGMAS = 1.5  # closest distance of a star to the edge of the image, in widths
MAX_SATURATED_PX = 9  # saturated pixels of a star that can still be fitted by its flanks
FAINT = 0.85  # of the threshold: the fit frees position and level too, so its SNR is lower
MISFIT = 3.0  # standard deviations of chi-square beyond which errors are inflated


@dataclass(frozen=True)
class ExtractionOptions(Options):
    """Options of the centroid extraction."""

    threshold: str = option(
        'sigma', 'threshold of the pixels of a star: sigma: 3 times their noise; fixed: '
        'threshold_dn, for detection too; iterative: computed in the window of the star',
        choices=('sigma', 'fixed', 'iterative'))
    threshold_sigma: float = option(
        5.5, 'detection threshold above the local background, in standard deviations of the '
        'filtered image',
        low=3.0, high=100.0)
    threshold_dn: float = option(
        50.0, 'fixed detection threshold above the local background', unit='DN', low=0.1,
        high=65535.0)
    method: str = option(
        'gaussian', 'gaussian: fit of the point spread function; others: mean of the pixels of '
        'a star with weight 1, light, light squared, light above the threshold',
        choices=(*WEIGHTS, 'gaussian'))
    psf_sigma_px: float = option(
        0.0, 'width (1 sigma) of a star image, 0: estimated from each image',
        unit='px', low=0.0, high=5.0)
    max_stars: int = option(
        40, 'maximum number of stars, the brightest ones', low=1, high=5000)


@dataclass(frozen=True)
class Extraction:
    """
    Centroids of an image, its background and its rejected spots.

    status is 'ok', 'no_stars', 'blank', 'saturated', 'too_small' or 'too_many'; reason explains
    it, empty when ok. background_dn and noise_dn (1 sigma of a pixel) are medians over the
    image, psf_sigma_px the width fitted with; NaN where not measured. rejected counts the
    spots left out, by reason.
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
        """Accept options, and a factor that falsifies the threshold of the weighted means."""
        self._options = options
        fixed_dn = options.threshold_dn if options.threshold == 'fixed' else 0.0
        self._threshold = Threshold(0.0 if fixed_dn else options.threshold_sigma, fixed_dn)
        self._segmentation = Segmentation(fixed_dn, options.threshold == 'iterative', factor)

    def extract(self, image: np.ndarray) -> Extraction:
        """Return the stars of image (H, W) uint8 or uint16; ValueError for anything else."""
        _check(image)
        height, width = image.shape
        if min(height, width) < MIN_SIDE_PX:
            return _none('too_small', f'image of {width} x {height} px, '
                         f'at least {MIN_SIDE_PX} px a side are needed')
        # Compiled for one layout, read-only, as in images out of DDS: padded rows are copied.
        image = np.require(image, requirements=['C', 'A']).view()
        image.flags.writeable = False
        frame = prepare(image, self._options.psf_sigma_px or FILTER_SIGMA_PX, self._threshold)
        if frame.blank:
            return _none('blank', f'all pixels are {image[0, 0]} DN')
        if frame.saturated:
            return _none('saturated', f'most pixels are at full scale, {frame.full_scale_dn:g} DN',
                         frame)
        frame, sigma_px = self._match_filter(frame)
        search, rejections = frame.search, Rejections()
        if search.too_many:
            return _none('too_many', f'{search.found} peaks: noise, not stars', frame)
        rejections.add('disc', search.discs)
        if not search.found:
            return _none('no_stars', f'no star image above {self._threshold.text}', frame,
                         rejections.counts)
        centroids = self._measure(frame, sigma_px, rejections)
        return Extraction(
            centroids, *(('ok', '') if len(centroids) else ('no_stars', 'every spot is rejected')),
            frame.background_dn, frame.noise_dn, sigma_px, rejections.counts)

    def warm_up(self) -> None:
        """Compile or load all compiled functions, so that the first image is not delayed."""
        rng = np.random.default_rng(1)
        image = rng.normal(50, 3, (64, 64))
        for u, v in ((15, 20), (50, 15), (30, 45)):
            image[v - 1:v + 2, u - 1:u + 2] += np.outer((40, 80, 40), (1, 2, 1))
        for kind in (np.uint8, np.uint16):
            self.extract(image.clip(0, 255).astype(kind))

    def _match_filter(self, frame: Frame) -> tuple[Frame, float]:
        """Return the width (px) of the stars and the frame, filtered anew if it does not match."""
        sigma_px = self._options.psf_sigma_px
        if sigma_px or not frame.search.found or frame.search.too_many:
            return frame, sigma_px
        sigma_px = measure_width(frame)
        if 1 / FILTER_RATIO < sigma_px / FILTER_SIGMA_PX < FILTER_RATIO:
            return frame, sigma_px
        frame = prepare(frame.image, float(np.clip(sigma_px, *FILTER_RANGE_PX)), self._threshold)
        return frame, measure_width(frame)

    def _measure(self, frame: Frame, sigma_px: float, rejections: Rejections) -> Centroids:
        """Fit stars of this width to the brightest peaks; return the good ones."""
        peaks = frame.search.peaks.select(slice(SPARE_PEAKS * self._options.max_stars))
        windows, start = frame.windows(peaks, sigma_px)
        keep = rejections.reject(
            edge=_border_px(frame, peaks) < np.ceil(EDGE_SIGMAS * sigma_px),
            saturated=windows.saturated_cores() > MAX_SATURATED_PX)
        windows, start, noise = _fit_roughly(
            frame, windows.select(keep), start[keep], rejections)
        fit = fit_stars(windows, start, noise)
        centroids = _centroids(fit)
        keep = rejections.reject(
            not_fitted=drifted(fit, windows) | duplicates(fit, windows),
            faint=_significance(fit) < FAINT * self._threshold.sigmas)
        if self._options.method != 'gaussian':
            uv, error_px = weighted_means(
                self._options.method, windows, fit, noise, self._segmentation)
            centroids = replace(centroids, uv=uv, sigma_px=error_px)
            keep &= rejections.reject(faint=keep & ~np.isfinite(uv[:, 0]))
        order = np.argsort(-centroids.flux, kind='stable')
        return centroids.select(order[keep[order]][:self._options.max_stars])


def _fit_roughly(frame: Frame, windows: Windows, start: np.ndarray, rejections: Rejections
                 ) -> tuple[Windows, np.ndarray, NoiseModel]:
    """Reject what is no star; return windows, parameters (K, 5) and noise model of the rest."""
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_stars(windows, start, noise, iterations=ROUGH_ITERATIONS)
    shape = classify_shapes(fit, windows)
    keep = rejections.reject(
        hot_pixel=shape.narrow & lone_pixels(windows.data), cosmic_ray=shape.narrow,
        elongated=shape.elongated, too_wide=shape.wide, not_fitted=drifted(fit, windows))
    noise = refine_noise_model(noise, fit, windows, keep & (windows.saturated_cores() == 0))
    return windows.select(keep), fit.parameters[keep], noise


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
    if frame is None:
        return Extraction(Centroids.empty(), status, reason, rejected=rejected or {})
    return Extraction(Centroids.empty(), status, reason, frame.background_dn, frame.noise_dn,
                      rejected=rejected or {})


def _border_px(frame: Frame, peaks: Peaks) -> np.ndarray:
    """Return the distance (K,) of the peaks to the edge of the image."""
    (height, width), (u, v) = frame.image.shape, peaks.uv.T
    return np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))


def _significance(fit: Fit) -> np.ndarray:
    """Return flux (K,) over its 1-sigma error by the noise model alone."""
    return fit.parameters[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX])


def _centroids(fit: Fit) -> Centroids:
    """Return all fitted stars; a misfit beyond chance inflates errors by sqrt(chi2 / dof)."""
    ratio = fit.chi2 / fit.dof
    inflation = np.where(ratio > 1 + MISFIT * np.sqrt(2 / fit.dof), np.sqrt(ratio), 1.0)
    variance = (fit.covariance[:, U, U] + fit.covariance[:, V, V]) / 2
    return Centroids(fit.parameters[:, :V + 1], fit.parameters[:, FLUX],
                     _significance(fit) / inflation, inflation * np.sqrt(variance))
