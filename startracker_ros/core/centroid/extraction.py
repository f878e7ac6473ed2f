"""
Star image to centroids, with a reason for every spot left out.

1. Background and peaks of the image (frame.py), after a matched filter. Discs, lines and storms
   of hits are taken out here, before the brightest peaks of each cell of the image are chosen.
2. Width of the stars (width.py), that of an image before where this one does not show it; if
   the filter does not match, step 1 once more.
3. Points (point_stars.py): rough fit, which rejects what is no star and measures the noise, then
   the final fit.
4. Streaks (streak_stars.py) instead, if the stars moved during the exposure: by a known streak,
   or by the one on which the spots agree (streak_search.py).
5. Points after wider filters, if many spots are no stars: a narrow one cuts defocused rings.

Once an image was searched, extract_near() measures stars at known positions only.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from startracker_ros.core.centroid.background import over_image, pixel_noise
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.cleaning import (
    are_hits, cleaned, find_spoilt, NOT_SPOILT, Spoilt)
from startracker_ros.core.centroid.detection import Peaks, Threshold
from startracker_ros.core.centroid.directed import peaks_near
from startracker_ros.core.centroid.frame import Frame, prepare
from startracker_ros.core.centroid.hits import is_hit, is_single
from startracker_ros.core.centroid.moments import Segmentation, WEIGHTS
from startracker_ros.core.centroid.point_stars import measure_points
from startracker_ros.core.centroid.pointing_error import pointing_error
from startracker_ros.core.centroid.psf import FLUX
from startracker_ros.core.centroid.quota import brightest
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.streak import SHORTEST_PX, Streak
from startracker_ros.core.centroid.streak_fit import streaks_at
from startracker_ros.core.centroid.streak_search import estimate_streak, search_streaks
from startracker_ros.core.centroid.streak_stars import measure_streaks
from startracker_ros.core.centroid.width import measure_width
from startracker_ros.core.options import option, Options

MIN_SIDE_PX = 8
FILTER_SIGMA_PX = 1.0  # while the width of the stars is unknown
FILTER_RATIO = 2.0  # a filter wrong by more than this factor is replaced
FILTER_RANGE_PX = (0.5, 5.0)
WIDE_FILTERS_PX = (2.5, 5.0)  # for stars that a narrow filter finds in pieces,
MISSHAPEN, MISSHAPEN_SHARE = ('elongated', 'too_wide', 'not_fitted'), 0.5  # for each star
WHOLE_STARS, WHOLE_RATIO = (4, 10), 2.0  # as many as were found have more light, if whole
SPARE_PEAKS = 2  # peaks fitted per star wanted, as some will be rejected
MOST_COMPARED = 40  # stars, the brightest, in the search for an error that all share
LEAST_ELONGATED = 4  # spots that may be streaks of stars,
ELONGATED_SHARE = 0.15  # if there are so many for each star


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
    line_time_us: float = option(
        0.0, 'rolling shutter: delay from one row to the next; 0: global shutter', unit='us',
        low=0.0, high=10000.0)
    readout_direction: str = option(
        'down', 'rolling shutter: whether the rows further down (+v) or up are exposed later',
        choices=('down', 'up'))


@dataclass(frozen=True)
class Extraction:
    """
    Centroids of an image, its background and its rejected spots.

    status is 'ok', 'no_stars', 'blank', 'saturated', 'too_small' or 'too_many'; reason explains
    it, empty when ok. background_dn and noise_dn (1 sigma of a pixel) are medians over the
    image, psf_sigma_px the width fitted with; NaN where not measured. rejected counts the
    spots left out, by reason; rejected_uv (R, 2) px are where they are. streak is the motion
    fitted with, None for points.
    """

    centroids: Centroids
    status: str
    reason: str
    background_dn: float = float('nan')
    noise_dn: float = float('nan')
    psf_sigma_px: float = float('nan')
    rejected: dict[str, int] = field(default_factory=dict)
    rejected_uv: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    streak: Streak | None = None

    @property
    def streak_px(self) -> float:
        """Length of the streaks in the middle of the image, zero for points."""
        return 0.0 if self.streak is None else self.streak.length_px


class CentroidExtractor:
    """
    Finds the stars of mono8 and mono16 images.

    extract() is a pure function of image and options; extract_near() measures with the
    background and the width of the last image that was searched, without what spoilt that one.
    """

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 factor: float = 1.0) -> None:
        """Accept options, and a factor that falsifies the threshold of the weighted means."""
        self._options = options
        fixed_dn = options.threshold_dn if options.threshold == 'fixed' else 0.0
        self._threshold = Threshold(0.0 if fixed_dn else options.threshold_sigma, fixed_dn)
        self._segmentation = Segmentation(fixed_dn, options.threshold == 'iterative', factor)
        up = options.readout_direction == 'up'
        self._line_time_s = options.line_time_us * (-1e-6 if up else 1e-6)
        self.reset()

    def reset(self) -> None:
        """Forget the images before."""
        self._reference: tuple[Frame, float] | None = None
        self._certain_width_px = 0.0
        self.spoilt = NOT_SPOILT
        self.most_stars = self._options.max_stars

    def extract(self, image: np.ndarray, streak: Streak | None = None, *,
                points_only: bool = False) -> Extraction:
        """
        Return the stars of image (H, W) uint8 or uint16; ValueError for anything else.

        streak is the motion of the exposure where it is known. Streaks and wide stars are not
        searched where points_only.
        """
        check_image(image)
        height, width = image.shape
        if min(height, width) < MIN_SIDE_PX:
            return _none('too_small', f'image of {width} x {height} px, '
                         f'at least {MIN_SIDE_PX} px a side are needed')
        image = _readable(image)
        frame = prepare(image, self._options.psf_sigma_px or FILTER_SIGMA_PX, self._threshold)
        if frame.blank:
            return _none('blank', f'all pixels are {image[0, 0]} DN')
        if frame.saturated:
            return _none('saturated', f'most pixels are at full scale, {frame.full_scale_dn:g} DN',
                         frame)
        taken_out, rejections = Rejections(), Rejections()
        frame, sigma_px = self._match_filter(self._clean(frame, taken_out))
        rejections.add('disc', frame.search.discs)
        rejections.add('line', frame.search.lines)
        if streak is None or streak.longest_px() < SHORTEST_PX:
            (centroids, smeared), streak = self._search(frame, sigma_px, rejections), None
            smeared |= _many_elongated(len(centroids), rejections)
            if smeared and not points_only:
                centroids, sigma_px, rejections, streak = self._as_streaks(
                    frame, centroids, sigma_px, rejections)
            misshapen = streak is None and _mostly_misshapen(len(centroids), rejections)
            if misshapen and not points_only:
                frame, centroids, sigma_px, rejections = self._as_wide(
                    frame, centroids, sigma_px, rejections)
        else:
            sigma_px = sigma_px if self._reference is None else self._reference[1]
            centroids = self._search_streaks(frame, streak, sigma_px, rejections)
        if not len(centroids) and frame.search.too_many:
            if self._reference is not None:
                self._reference = frame, self._reference[1]
            return _none('too_many', f'{frame.search.found} peaks: noise, not stars', frame)
        self._reference = frame, sigma_px
        rejections.include(taken_out)
        return self._result(centroids, frame, sigma_px, rejections, streak)

    def extract_near(self, image: np.ndarray, uv: np.ndarray, radius_px: np.ndarray,
                     streak: Streak | None = None) -> Extraction | None:
        """
        Return the stars of image (H, W) within radius_px (K,) of predicted positions uv (K, 2).

        None if no image of this size and type has been searched yet.
        """
        check_image(image)
        if (self._reference is None or self._reference[0].image.shape != image.shape
                or self._reference[0].image.dtype != image.dtype):
            return None
        before, sigma_px = self._reference
        clean = (image if self.spoilt == NOT_SPOILT
                 else cleaned(image, before.mesh, self.spoilt, sigma_px)[0])
        frame, rejections = replace(before, image=_readable(clean)), Rejections()
        if streak is None or streak.longest_px() < SHORTEST_PX:
            peaks, found = peaks_near(frame.image, frame.kernel, frame.mesh, self._threshold, uv,
                                      radius_px)
            if not self.spoilt.hits and are_hits(frame, peaks, sigma_px):
                self.spoilt = self.spoilt._replace(hits=True)
                return self.extract_near(image, uv, radius_px, streak)
            rejections.add('faint', uv[~found])
            return self._result(self._measure(frame, peaks, sigma_px, rejections)[0], frame,
                                sigma_px, rejections, None)
        centroids = measure_streaks(frame, uv, streak, sigma_px, self._threshold.sigmas,
                                    rejections)
        return self._result(centroids, frame, sigma_px, rejections, streak)

    def warm_up(self) -> None:
        """Compile or load all compiled functions, so that the first image is not delayed."""
        rng = np.random.default_rng(1)
        image = rng.normal(50, 3, (64, 64))
        stars = np.array([(15, 20), (50, 15), (30, 45)])
        for u, v in stars:
            image[v - 1:v + 2, u - 1:u + 2] += np.outer((40, 80, 40), (1, 2, 1))
        streak = Streak(4.0, 2.0, 0.0, 31.5, 31.5)
        for kind in (np.uint8, np.uint16):
            frame = image.clip(0, 255).astype(kind)
            self.extract(frame, streak)
            self.extract(frame)
            self.extract_near(frame, stars.astype(float), np.full(3, 3.0))
            clear = prepare(_readable(frame), FILTER_SIGMA_PX, self._threshold)
            cleaned(clear.image, clear.mesh, Spoilt(hits=True), FILTER_SIGMA_PX)
        self.reset()

    def _result(self, centroids: Centroids, frame: Frame, sigma_px: float,
                rejections: Rejections, streak: Streak | None) -> Extraction:
        """Return the brightest centroids, with the delays of their rows."""
        order = np.argsort(-centroids.flux, kind='stable')[:self.most_stars]
        centroids = centroids.select(order)
        if self._line_time_s:
            middle = (frame.image.shape[0] - 1) / 2
            centroids = replace(
                centroids, delay_s=(centroids.uv[:, 1] - middle) * self._line_time_s)
        common = self._pointing_error(centroids, frame, sigma_px, streak)
        if common.any():
            centroids = replace(centroids, common=np.tile(common, (len(centroids), 1, 1)))
        uv = np.concatenate(rejections.uv) if rejections.uv else np.empty((0, 2))
        if len(centroids):
            status, reason = 'ok', ''
        elif frame.search.found:
            status, reason = 'no_stars', 'every spot is rejected'
        else:
            status, reason = 'no_stars', f'no star image above {self._threshold.text}'
        return Extraction(centroids, status, reason, frame.background_dn, frame.noise_dn,
                          sigma_px, rejections.counts, uv, streak)

    def _pointing_error(self, centroids: Centroids, frame: Frame, sigma_px: float,
                        streak: Streak | None) -> np.ndarray:
        """Return the covariance (2, 2) px^2 of the error that the brightest stars share."""
        uv = centroids.uv[:MOST_COMPARED]
        moved_px = np.zeros((len(uv), 2)) if streak is None else streak.at(uv)
        stars = streaks_at(uv, moved_px, sigma_px)
        stars[:, FLUX] = centroids.flux[:MOST_COMPARED]
        return pointing_error(
            frame.image, frame.mesh, frame.full_scale_dn, stars, streak is not None)

    def _clean(self, frame: Frame, rejections: Rejections) -> Frame:
        """Return the frame, searched anew without what spoils the image."""
        self.spoilt = find_spoilt(frame)
        if self.spoilt == NOT_SPOILT:
            return frame
        rejections.add('disc', frame.search.discs)
        rejections.add('line', frame.search.lines)
        sigma_px = FILTER_SIGMA_PX if self._reference is None else self._reference[1]
        image, hits = cleaned(frame.image, frame.mesh, self.spoilt, sigma_px)
        rejections.add('hot_pixel', hits)
        return prepare(_readable(image), frame.kernel.sigma_px, self._threshold,
                       pixel_noise(image) if self.spoilt.hits else 0.0)

    def _match_filter(self, frame: Frame) -> tuple[Frame, float]:
        """Return the width (px) of the stars and the frame, filtered anew if it does not match."""
        if not frame.search.found:
            return frame, self._options.psf_sigma_px or FILTER_SIGMA_PX
        sigma_px = self._width_px(frame)
        if 1 / FILTER_RATIO < sigma_px / frame.kernel.sigma_px < FILTER_RATIO:
            return frame, sigma_px
        frame = prepare(frame.image, float(np.clip(sigma_px, *FILTER_RANGE_PX)), self._threshold)
        return frame, self._width_px(frame)

    def _width_px(self, frame: Frame) -> float:
        """Return the width of the stars: where a frame does not show it, that of those before."""
        if self._options.psf_sigma_px:
            return self._options.psf_sigma_px
        width_px, certain = measure_width(frame)
        if certain:
            self._certain_width_px = width_px
        return self._certain_width_px or width_px

    def _search(self, frame: Frame, sigma_px: float, rejections: Rejections
                ) -> tuple[Centroids, bool]:
        """Return the stars among the peaks of the frame, and whether all are smeared."""
        peaks = frame.search.peaks
        if not len(peaks.uv):
            return Centroids.empty(), False
        hit = is_hit(frame.image, peaks.uv, peaks.level, peaks.noise / frame.kernel.noise_gain,
                     min(sigma_px, FILTER_SIGMA_PX))
        single = is_single(frame.image, peaks.uv, peaks.level)
        peaks = peaks.select(rejections.reject(
            peaks.uv, hot_pixel=hit & single, cosmic_ray=hit))
        chosen, others = self._brightest(peaks, frame.image.shape), Rejections()
        centroids, smeared = self._measure(frame, chosen, sigma_px, others)
        if len(centroids) < self.most_stars / 2 and len(chosen.uv) < len(peaks.uv):
            # What is no star fills the list of the brightest: all peaks are fitted.
            others = Rejections()
            centroids, smeared = self._measure(frame, peaks, sigma_px, others)
        rejections.include(others)
        return centroids, smeared

    def _measure(self, frame: Frame, peaks: Peaks, sigma_px: float, rejections: Rejections
                 ) -> tuple[Centroids, bool]:
        return measure_points(frame, peaks, sigma_px, self._threshold.sigmas,
                              self._options.method, self._segmentation, rejections)

    def _as_streaks(self, frame: Frame, points: Centroids, sigma_px: float,
                    rejections: Rejections
                    ) -> tuple[Centroids, float, Rejections, Streak | None]:
        """Return the stars as streaks, their width and motion, unless points explain more."""
        found = estimate_streak(frame.image, frame.mesh, frame.noise_dn, frame.full_scale_dn,
                                FILTER_SIGMA_PX)
        if found is not None:
            others = Rejections()
            streaks = self._search_streaks(frame, *found, others)
            if len(streaks) > max(LEAST_ELONGATED, len(points) / 2):
                return streaks, found[1], others, found[0]
        return points, sigma_px, rejections, None

    def _as_wide(self, frame: Frame, points: Centroids, sigma_px: float, rejections: Rejections
                 ) -> tuple[Frame, Centroids, float, Rejections]:
        """Return frame and stars after the filter whose stars have the most light."""
        for filter_px in () if self._options.psf_sigma_px else WIDE_FILTERS_PX:
            wide, others = prepare(frame.image, filter_px, self._threshold), Rejections()
            width_px, _ = measure_width(wide)
            stars, _ = self._search(wide, width_px, others)
            rank = int(np.clip(len(points), *WHOLE_STARS))
            if _light(stars, rank) > WHOLE_RATIO * _light(points, rank):
                frame, points, sigma_px, rejections = wide, stars, width_px, others
        return frame, points, sigma_px, rejections

    def _search_streaks(self, frame: Frame, streak: Streak, sigma_px: float,
                        rejections: Rejections) -> Centroids:
        """Return the stars of a smeared frame."""
        found = search_streaks(frame.image, over_image(frame.mesh.level, frame.image.shape),
                               streak, sigma_px, self._threshold.sigmas)
        chosen = brightest(found, frame.image.shape, SPARE_PEAKS * self.most_stars)
        return measure_streaks(frame, found[chosen], streak, sigma_px, self._threshold.sigmas,
                               rejections)

    def _brightest(self, peaks: Peaks, shape: tuple[int, ...]) -> Peaks:
        """Return the peaks that are fitted, brightest first."""
        return peaks.select(brightest(peaks.uv, shape, SPARE_PEAKS * self.most_stars))


def _many_elongated(stars: int, rejections: Rejections) -> bool:
    """Return whether so many spots are longer than stars that these may be streaks."""
    counts = rejections.counts
    elongated = counts.get('elongated', 0) + counts.get('line', 0)
    return elongated >= max(LEAST_ELONGATED, ELONGATED_SHARE * stars)


def _mostly_misshapen(stars: int, rejections: Rejections) -> bool:
    """Return whether so many spots have another shape that the stars may be pieces too."""
    misshapen = sum(rejections.counts.get(reason, 0) for reason in MISSHAPEN)
    return misshapen > max(MISSHAPEN_SHARE * stars, LEAST_ELONGATED)


def _light(stars: Centroids, rank: int) -> float:
    """Return the light of the star of a rank, the brightest being 1; zero where there is none."""
    return float(np.sort(stars.flux)[-rank]) if len(stars) >= rank else 0.0


def _readable(image: np.ndarray) -> np.ndarray:
    """Return the image as compiled functions know it: in one block and read-only."""
    # Read-only, as in images out of DDS: padded rows are copied.
    image = np.require(image, requirements=['C', 'A']).view()
    image.flags.writeable = False
    return image


def check_image(image: np.ndarray) -> None:
    """Raise ValueError for what is no image (H, W) uint8 or uint16."""
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f'image is {kind}, must be uint8 or uint16')
    if image.ndim != 2:
        raise ValueError(f'image has {image.ndim} dimensions, must have 2 (grey)')
    if not image.size:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px is empty')


def _none(status: str, reason: str, frame: Frame | None = None) -> Extraction:
    measured = () if frame is None else (frame.background_dn, frame.noise_dn)
    return Extraction(Centroids.empty(), status, reason, *measured)
