# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star image to centroids, with a reason for every spot left out.

1. Background and peaks of the image (frame.py), after a matched filter. Discs, lines and storms
   of hits are taken out here, before the brightest peaks of each cell of the image are chosen.
2. PSF sigma (psf_sigma.py), that of an image before where this one does not show it; if
   the filter does not match, step 1 once more.
3. Points (point_stars.py): rough fit, which rejects what is no star and measures the noise, then
   the final fit.
4. Streaks (streak_search.py) instead, if the stars moved during the exposure: by a known streak,
   or by the one on which the spots agree.
5. Points after wider filters, if many spots are no stars: a narrow one cuts defocused rings.

6. Spots of any shape (spots.py) beside the points, if these are still not most of the bright
   spots: no point, streak or disc describes an aberrated or clipped star, but its flux is there.

Once an image was searched, search_near() measures stars at known positions only.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np
from startracker_ros.core.centroid.background import Mesh, over_image, pixel_noise, readable
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.detection import Peaks, Threshold
from startracker_ros.core.centroid.frame import Frame, prepare
from startracker_ros.core.centroid.hits import (
    is_hit, is_single, is_storm, least_share, without_hits)
from startracker_ros.core.centroid.moments import Segmentation, WEIGHTS
from startracker_ros.core.centroid.point_stars import measure_points
from startracker_ros.core.centroid.pointing_error import pointing_error
from startracker_ros.core.centroid.psf import FLUX, SIGMA, V
from startracker_ros.core.centroid.psf_sigma import measure_psf_sigma
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.spots import (
    BRIGHT_SPOTS, brightest, explained_spots, find_spots, with_near_spots, with_spots)
from startracker_ros.core.centroid.streak import SHORTEST_PX, Streak
from startracker_ros.core.centroid.streak_fit import ANGLE, streaks_at
from startracker_ros.core.centroid.streak_search import (
    estimate_streak, measure_streaks, search_streaks)
from startracker_ros.core.centroid.windowed_search import peaks_near
from startracker_ros.core.options import option, Options

# --- hits, trails, columns and discs are taken out of an image ---

LARGE_PX = 120  # across; the longest streak of a star is shorter
LARGE_PEAKS = 30  # on lines and discs, from which on these are taken out as a whole
LARGE_SIGMAS = 3.0  # above the background
MARGIN_PX = 3  # around something large, where its flux falls below that
MAX_SHARE = 0.6  # of the image; more is no artefact in a field of stars


class Contamination(NamedTuple):
    """What contaminates an image: hits of particles, or something large."""

    hits: bool = False
    large: bool = False


CLEAN = Contamination()


def find_contamination(frame: Frame) -> Contamination:
    """Return what contaminates the image of a frame."""
    search = frame.search
    return Contamination(
        search.too_many or is_storm(frame.image, search.peaks.uv, search.peaks.level),
        len(search.lines) + len(search.discs) >= LARGE_PEAKS)


def cleaned(image: np.ndarray, mesh: Mesh, contamination: Contamination, sigma_px: float
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return image (H, W) without what contaminates it, and the pixels u, v (N, 2) of hits.

    mesh is its background, sigma_px the width of its stars. What is taken out gets the level of
    the background.
    """
    noise_dn, hits = pixel_noise(image), np.empty((0, 2), int)
    if contamination.large:
        image = _without_large(image, over_image(mesh.level, image.shape), noise_dn)
    if contamination.hits:
        image, hit = without_hits(image, mesh, noise_dn, sigma_px)
        hits = np.argwhere(hit)[:, ::-1]
    return readable(image), hits


def _without_large(image: np.ndarray, level: np.ndarray, noise_dn: float) -> np.ndarray:
    """Return image (H, W) without connected bright pixels that extend over LARGE_PX."""
    bright = (image > level + np.float32(LARGE_SIGMAS * noise_dn)).astype(np.uint8)
    _, label, box, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    across = np.maximum(box[:, cv2.CC_STAT_WIDTH], box[:, cv2.CC_STAT_HEIGHT])
    large = (across > LARGE_PX) & (np.arange(len(box)) > 0)
    if not large.any():
        return image
    side = 2 * MARGIN_PX + 1
    mask = cv2.dilate(large.astype(np.uint8)[label], np.ones((side, side), np.uint8)) > 0
    if mask.mean() > MAX_SHARE:
        return image
    clean = image.copy()
    clean[mask] = np.rint(level[mask]).clip(0, np.iinfo(image.dtype).max)
    return readable(clean)


# --- centroids ---

MIN_SIDE_PX = 8
FILTER_SIGMA_PX = 1.0  # while the PSF sigma is unknown
FILTER_RATIO = 2.0  # a filter wrong by more than this factor is replaced
FILTER_RANGE_PX = (0.5, 5.0)
WIDE_FILTERS_PX = (2.5, 5.0)  # for stars that a narrow filter finds in pieces,
MISSHAPEN, MISSHAPEN_SHARE = ('elongated', 'too_wide', 'not_fitted'), 0.5  # for each star
WHOLE_STARS, WHOLE_RATIO = (4, 10), 2.0  # as many as were found have more flux, if whole
SPARE_PEAKS = 2  # peaks fitted per star wanted, as some will be rejected
MOST_COMPARED = 40  # stars, the brightest, in the search for an error that all share
MISSED_SHARE, LEAST_MISSED = 0.1, 2  # misshapen spots for each star, and at least
SIGMA_IMAGES = 60  # searched ones, for which a PSF sigma stays known
STREAK_SHARE = 0.5  # of the brightest spots in an image of streaks
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
        'a star with weight 1, flux, flux squared, flux above the threshold',
        choices=(*WEIGHTS, 'gaussian'))
    psf_sigma_px: float = option(
        0.0, 'width (1 sigma) of a star image, 0: estimated from each image',
        unit='px', low=0.0, high=5.0)
    max_stars: int = option(
        40, 'maximum number of stars, the brightest ones', low=1, high=5000)
    exposure_s: float = option(
        0.0, 'exposure time of the images; 0: that of exposure_start, without it learnt from the '
        'length of streaks', unit='s', low=0.0, high=600.0)
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
    image, psf_sigma_px that fitted with; NaN where not measured. rejected counts the
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


class KnownSigma(NamedTuple):
    """PSF sigma in px that an image showed with certainty, 0 for none, some images ago."""

    sigma_px: float = 0.0
    images: int = 0

    def older(self) -> 'KnownSigma':
        """Return what is known of it in the next image."""
        return KnownSigma() if self.images >= SIGMA_IMAGES else self._replace(
            images=self.images + 1)


class Searched(NamedTuple):
    """
    What a searched image leaves for those after it.

    frame is that image with its background, sigma_px the PSF sigma of its stars, known the last
    one that was certain; contamination is what was taken out of it; any_shape is whether it has
    stars that no point describes.
    """

    frame: Frame
    sigma_px: float
    known: KnownSigma
    contamination: Contamination
    any_shape: bool = False

    def fits(self, image: np.ndarray) -> bool:
        """Return whether an image has the size and the type of the one that was searched."""
        before = self.frame.image
        return bool(before.shape == image.shape and self.frame.bits == _bits(image))


class CentroidExtractor:
    """
    Finds the stars of mono8 and mono16 images.

    measure() is a pure function of image and options. search() and search_near() are so too;
    what an image leaves for those after it is passed in and returned.
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

    def measure(self, image: np.ndarray, streak: Streak | None = None, *,
                points_only: bool = False) -> Extraction:
        """Return the stars of image (H, W) as search() does, of an image without any before."""
        return self.search(image, streak, points_only=points_only)[0]

    def search(self, image: np.ndarray, streak: Streak | None = None,
               before: Searched | None = None, *, most_stars: int = 0,
               points_only: bool = False, narrow: bool = False
               ) -> tuple[Extraction, Searched | None]:
        """
        Return the stars of image (H, W) uint8 or uint16; ValueError for anything else.

        streak is the motion of the exposure where it is known, before the last image of this
        camera that was searched, most_stars the number of stars, 0 for that of the options.
        Only points are searched where points_only, and those of the narrowest spots where narrow
        too. The second result is `before` of the next image.
        """
        check_image(image)
        height, width = image.shape
        if min(height, width) < MIN_SIDE_PX:
            return _none('too_small', f'image of {width} x {height} px, '
                         f'at least {MIN_SIDE_PX} px a side are needed'), before
        if before is not None and not before.fits(image):
            before = None
        bits, image = _bits(image), readable(image)
        frame = prepare(image, self._options.psf_sigma_px or FILTER_SIGMA_PX, self._threshold,
                        bits)
        if frame.blank:
            return _none('blank', f'all pixels are {image[0, 0]} DN'), before
        if frame.saturated:
            return _none('saturated', f'most pixels are at full scale, {frame.full_scale_dn:g} DN',
                         frame), before
        most = most_stars or self._options.max_stars
        taken_out, rejections = Rejections(), Rejections()
        frame, contamination = self._clean(frame, before, taken_out)
        frame, sigma_px, known = self._match_filter(
            frame, KnownSigma() if before is None or narrow else before.known.older(), narrow)
        rejections.add('disc', frame.search.discs)
        rejections.add('line', frame.search.lines)
        any_shape = False
        if streak is None or streak.longest_px() < SHORTEST_PX:
            streak = None
            centroids, smeared = self._points(frame, sigma_px, most, rejections)
            if not points_only:
                smeared |= _many_elongated(len(centroids), rejections)
                frame, centroids, sigma_px, rejections, streak, any_shape = self._other_shapes(
                    frame, centroids, sigma_px, most, rejections, smeared)
        else:
            sigma_px = sigma_px if before is None else before.sigma_px
            centroids = self._search_streaks(frame, streak, sigma_px, most, rejections)
        if not len(centroids) and frame.search.too_many:
            return (_none('too_many', f'{frame.search.found} peaks: noise, not stars: raise the '
                          'threshold, or subtract a dark frame', frame),
                    before and before._replace(
                        frame=frame, known=known, contamination=contamination))
        rejections.include(taken_out)
        return (self._result(centroids, frame, sigma_px, most, rejections, streak),
                Searched(frame, sigma_px, known, contamination, any_shape))

    def search_near(self, image: np.ndarray, uv: np.ndarray, radius_px: np.ndarray,
                    before: Searched, streak: Streak | None = None
                    ) -> tuple[Extraction, Searched]:
        """
        Return the stars of image (H, W) within radius_px (K,) of predicted positions uv (K, 2).

        before is the last image that was searched, of the same size and type; it gives
        background and PSF sigma, and its contamination is taken out here too. The second result is
        `before` of the next image.
        """
        check_image(image)
        clean = readable(image)
        if before.contamination != CLEAN:
            clean, _ = cleaned(clean, before.frame.mesh, before.contamination, before.sigma_px)
        frame = before.frame.followed_by(clean, uv, before.contamination.hits)
        before, rejections = before._replace(frame=frame), Rejections()
        sigma_px = before.sigma_px
        if streak is None or streak.longest_px() < SHORTEST_PX:
            peaks, found, hits = peaks_near(
                frame.image, frame.kernel, frame.mesh, self._threshold, uv, radius_px,
                least_share(sigma_px))
            if hits and not before.contamination.hits:
                before = before._replace(contamination=before.contamination._replace(hits=True))
                return self.search_near(image, uv, radius_px, before, streak)
            rejections.add('faint', uv[~found])
            centroids = self._measure(frame, peaks, sigma_px, rejections,
                                      self._options.max_stars)[0]
            if before.any_shape:
                centroids = with_near_spots(centroids, find_spots(frame.image), uv, radius_px)
            streak = None
        else:
            centroids = measure_streaks(frame, uv, streak, sigma_px, self._threshold.sigmas,
                                        rejections)
        return self._result(centroids, frame, sigma_px, self._options.max_stars, rejections,
                            streak), before

    def warm_up(self) -> None:
        """Compile or load all compiled functions, so that the first image is not delayed."""
        rng = np.random.default_rng(1)
        image = rng.normal(50, 3, (64, 64))
        stars = np.array([(15, 20), (50, 15), (30, 45)])
        for u, v in stars:
            image[v - 1:v + 2, u - 1:u + 2] += np.outer((40, 80, 40), (1, 2, 1))
        streak = Streak(4.0, 2.0, 0.0, 31.5, 31.5)
        frame = image.clip(0, 255).astype(np.uint8)
        self.measure(frame, streak)
        _, searched = self.search(frame)
        if searched is not None:
            self.search_near(frame, stars.astype(float), np.full(3, 3.0), searched)
            clear = searched.frame
            cleaned(clear.image, clear.mesh, Contamination(hits=True), FILTER_SIGMA_PX)

    def _result(self, centroids: Centroids, frame: Frame, sigma_px: float, most: int,
                rejections: Rejections, streak: Streak | None) -> Extraction:
        """Return the brightest centroids, with the delays of their rows."""
        centroids = centroids.brightest(most)
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
        elif rejections.counts:
            status, reason = 'no_stars', rejections.text
        else:
            status, reason = 'no_stars', (f'no star image above {self._threshold.text}: expose '
                                          'longer, focus, or lower the threshold')
        return Extraction(centroids, status, reason, frame.background_dn, frame.noise_dn,
                          sigma_px, rejections.counts, uv, streak)

    def _pointing_error(self, centroids: Centroids, frame: Frame, sigma_px: float,
                        streak: Streak | None) -> np.ndarray:
        """Return the covariance (2, 2) px^2 of the error that the brightest stars share."""
        uv = centroids.uv[:MOST_COMPARED]
        stars = np.zeros((len(uv), ANGLE + 1)) if streak is None else streaks_at(
            uv, streak.at(uv), sigma_px)
        stars[:, :V + 1], stars[:, FLUX], stars[:, SIGMA] = uv, centroids.flux[:len(uv)], sigma_px
        return pointing_error(
            frame.image, frame.mesh, frame.full_scale_dn, stars, streak is not None)

    def _clean(self, frame: Frame, before: Searched | None, rejections: Rejections
               ) -> tuple[Frame, Contamination]:
        """Return the frame, searched anew without its contamination, and what that is."""
        contamination = find_contamination(frame)
        if contamination == CLEAN:
            return frame, contamination
        rejections.add('disc', frame.search.discs)
        rejections.add('line', frame.search.lines)
        sigma_px = FILTER_SIGMA_PX if before is None else before.sigma_px
        image, hits = cleaned(frame.image, frame.mesh, contamination, sigma_px)
        rejections.add('hot_pixel', hits)
        return prepare(image, frame.kernel.sigma_px, self._threshold, frame.bits,
                       contamination.hits), contamination

    def _match_filter(self, frame: Frame, known: KnownSigma, narrow: bool
                      ) -> tuple[Frame, float, KnownSigma]:
        """Return the frame, filtered anew if the filter does not match, and the PSF sigma."""
        if not frame.search.found:
            return frame, self._options.psf_sigma_px or FILTER_SIGMA_PX, known
        sigma_px, known = self._psf_sigma(frame, known, narrow)
        if 1 / FILTER_RATIO < sigma_px / frame.kernel.sigma_px < FILTER_RATIO:
            return frame, sigma_px, known
        frame = prepare(frame.image, float(np.clip(sigma_px, *FILTER_RANGE_PX)), self._threshold,
                        frame.bits)
        return frame, *self._psf_sigma(frame, known, narrow)

    def _psf_sigma(self, frame: Frame, known: KnownSigma, narrow: bool
                   ) -> tuple[float, KnownSigma]:
        """Return the PSF sigma: where a frame does not show it, the one that is known."""
        if self._options.psf_sigma_px:
            return self._options.psf_sigma_px, known
        sigma_px, certain = measure_psf_sigma(frame, narrow)
        if certain:
            known = KnownSigma(sigma_px)
        return known.sigma_px or sigma_px, known

    def _points(self, frame: Frame, sigma_px: float, most: int, rejections: Rejections
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
        chosen = peaks.select(brightest(peaks.uv, frame.image.shape, SPARE_PEAKS * most))
        others = Rejections()
        centroids, smeared = self._measure(frame, chosen, sigma_px, others, len(chosen.uv))
        if len(centroids) < most / 2 and len(chosen.uv) < len(peaks.uv):
            # What is no star fills the list of the brightest: all peaks are fitted.
            others = Rejections()
            centroids, smeared = self._measure(frame, peaks, sigma_px, others, len(peaks.uv))
        rejections.include(others)
        return centroids, smeared

    def _measure(self, frame: Frame, peaks: Peaks, sigma_px: float, rejections: Rejections,
                 most: int) -> tuple[Centroids, bool]:
        return measure_points(frame, peaks, sigma_px, self._threshold.sigmas,
                              self._options.method, self._segmentation, rejections, most)

    def _other_shapes(self, frame: Frame, points: Centroids, sigma_px: float, most: int,
                      rejections: Rejections, smeared: bool
                      ) -> tuple[Frame, Centroids, float, Rejections, Streak | None, bool]:
        """
        Return frame, stars, PSF sigma and motion where other shapes than points explain more.

        The last result is whether spots of any shape are among the stars.
        """
        spots = None
        if smeared:
            found = estimate_streak(frame.image, frame.mesh, frame.noise_dn, frame.full_scale_dn,
                                    FILTER_SIGMA_PX)
            if found is not None:
                spots, others = find_spots(frame.image), Rejections()
                streaks = self._search_streaks(frame, *found, most, others)
                if (len(streaks) > max(LEAST_ELONGATED, len(points) / 2)
                        and _shows_streaks(spots, points, streaks, found[0].longest_px())):
                    return frame, streaks, found[1], others, found[0], False
        if _mostly_misshapen(len(points), rejections):
            frame, points, sigma_px, rejections = self._as_wide(
                frame, points, sigma_px, most, rejections)
        if not _misses_spots(len(points), rejections):
            return frame, points, sigma_px, rejections, None, False
        spots = find_spots(frame.image) if spots is None else spots
        return (frame, with_spots(points, spots, most), sigma_px, rejections, None, True)

    def _as_wide(self, frame: Frame, points: Centroids, sigma_px: float, most: int,
                 rejections: Rejections) -> tuple[Frame, Centroids, float, Rejections]:
        """Return frame and stars after the filter whose stars have the most flux."""
        for filter_px in () if self._options.psf_sigma_px else WIDE_FILTERS_PX:
            wide = prepare(frame.image, filter_px, self._threshold, frame.bits)
            others = Rejections()
            wide_sigma_px, _ = measure_psf_sigma(wide)
            stars, _ = self._points(wide, wide_sigma_px, most, others)
            if _have_more_flux(stars, points):
                frame, points, sigma_px, rejections = wide, stars, wide_sigma_px, others
        return frame, points, sigma_px, rejections

    def _search_streaks(self, frame: Frame, streak: Streak, sigma_px: float, most: int,
                        rejections: Rejections) -> Centroids:
        """Return the stars of a smeared frame."""
        found = search_streaks(frame.image, over_image(frame.mesh.level, frame.image.shape),
                               streak, sigma_px, self._threshold.sigmas)
        chosen = brightest(found, frame.image.shape, SPARE_PEAKS * most)
        return measure_streaks(frame, found[chosen], streak, sigma_px, self._threshold.sigmas,
                               rejections)


def _many_elongated(stars: int, rejections: Rejections) -> bool:
    """Return whether so many spots are longer than stars that these may be streaks."""
    counts = rejections.counts
    elongated = counts.get('elongated', 0) + counts.get('line', 0)
    return elongated >= max(LEAST_ELONGATED, ELONGATED_SHARE * stars)


def _mostly_misshapen(stars: int, rejections: Rejections) -> bool:
    """Return whether so many spots have another shape that the stars may be pieces too."""
    misshapen = sum(rejections.counts.get(reason, 0) for reason in MISSHAPEN)
    return misshapen > max(MISSHAPEN_SHARE * stars, LEAST_ELONGATED)


def _misses_spots(stars: int, rejections: Rejections) -> bool:
    """Return whether so many spots have another shape that stars may be among them."""
    missed = sum(rejections.counts.get(reason, 0) for reason in MISSHAPEN)
    return missed > max(MISSED_SHARE * stars, LEAST_MISSED)


def _shows_streaks(spots: Centroids, points: Centroids, streaks: Centroids, longest_px: float
                   ) -> bool:
    """Return whether streaks explain most of the brightest spots, and no fewer than points."""
    explained = explained_spots(spots, streaks, longest_px / 2)
    return (explained >= explained_spots(spots, points)
            and explained > STREAK_SHARE * min(len(spots), BRIGHT_SPOTS))


def _have_more_flux(others: Centroids, stars: Centroids) -> bool:
    """Return whether others are whole where stars are pieces, by the star of a rank."""
    rank = int(np.clip(len(stars), *WHOLE_STARS))
    return _flux_of_rank(others, rank) > WHOLE_RATIO * _flux_of_rank(stars, rank)


def _flux_of_rank(stars: Centroids, rank: int) -> float:
    """Return the flux of the star of a rank, the brightest being 1; zero where there is none."""
    return float(np.sort(stars.flux)[-rank]) if len(stars) >= rank else 0.0


def _bits(image: np.ndarray) -> int:
    return 8 * image.dtype.itemsize


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
