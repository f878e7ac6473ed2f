# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which images are searched as a whole, and in which only predicted centroids are measured."""

from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids, UNKNOWN_EXPOSURE
from startracker_ros.core.centroid.extraction import (
    CentroidExtractor, Extraction, ExtractionOptions, Searched)
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.centroid.streak import SHORTEST_PX, Streak
from startracker_ros.core.compiled import compiled
from startracker_ros.core.options import option, Options

LEAST_PREDICTED = 4
LEAST_SHARE = 0.75  # of the predicted stars that were seen in the image searched last
MAX_AGE_S = 1.0  # of a prediction
GATE_SIGMAS = 4.0
GATE_PX = 2.0  # for accelerations that a prediction does not know
MAX_GATE_PX = 8.0  # of a star
MAX_TARGET_PX = 32.0  # of a target; the whole image is searched for one that may be further away
SAME_PX = 3.0  # two centroids closer than this are of one star
REPEATED_PX = 0.5  # motion from which on an equal image is that of the frame before
MAX_ASTRAY, MAX_ASTRAY_PX = 0.5, 2.0  # of a streak, across the motion of the stars
MAX_ASTRAY_IMAGES = 2  # in a row that are refused
MAX_EXPOSURE = 1.2  # of the interval between images, with the error of its estimate
IMAGES_TO_ACQUIRE = 2  # a star tracker needs the identifications of two
WIDE_PX = 1.6  # PSF sigma beyond which spots may be debris
EXPOSURE_DOUBT = 0.06  # of an exposure that the streaks of an image show
EXPOSURE_IMAGES = 20  # that a learnt exposure is the mean of
EXPOSURE_CHANGED = 0.2  # by which an image shows that the exposure is another one
POINT_PX = 4.0  # a longer streak is none that is seen as a point
FASTER = 2.0  # times the speed at which stars were points: they may be streaks

COMPARED = 64  # rows of an image,
COMPARED_COLUMNS = 512  # of them, in the middle; first one in COMPARED_PX:
COMPARED_PX = 32  # rows that differ there are not equal
LEAST_NOISY = 0.02  # share of a row's pixels that are not its median: it is no dead or dark row
LEAST_ROWS = 0.5  # share of the rows that are noisy: compression leaves noise in few


@dataclass(frozen=True)
class SearchOptions(Options):
    """How often an image is searched as a whole."""

    search_period_s: float = option(
        1.0, 'time between two images that are searched as a whole while the star tracker '
        'predicts where its stars are; in the others only these are measured; 0: every image '
        'is searched', unit='s', low=0.0, high=3600.0)
    max_stars_lost: int = option(
        160, 'maximum number of stars while the star tracker is lost: max_stars in the first '
        'two images, then twice as many in every further two, for stars among brighter spots',
        low=1, high=5000)


class _Expected(NamedTuple):
    """
    The predicted centroids at the time of an image.

    uv (K, 2) px and radius_px (K,) of where they are: the first ones are stars, the others
    targets; anywhere is whether a target may be further away than a window reaches. motion is that
    of the stars in a second, over the image; interval_s is the time since the image before.
    """

    uv: np.ndarray
    radius_px: np.ndarray
    stars: int
    anywhere: bool
    motion: Streak
    speed_px_s: float
    interval_s: float

    @classmethod
    def at(cls, stamp_ns: int, predicted: PredictedCentroids, shape: tuple[int, int],
           interval_s: float) -> '_Expected':
        """Return the predicted centroids at a time."""
        uv, radius_px, speed_px_s = _windows_at(
            (stamp_ns - predicted.stamp_ns) * 1e-9, predicted.uv, predicted.velocity,
            predicted.sigma_px, predicted.stars)
        return cls(uv, radius_px, predicted.stars, len(uv) < len(predicted.uv),
                   predicted.motion(shape), speed_px_s, interval_s)

    def stars_seen(self, centroids: Centroids) -> int:
        """Return near how many of the predicted stars there is a centroid."""
        return _count_near(self.uv[:self.stars], centroids.uv, MAX_GATE_PX)

    def exposure_s(self, streak: Streak | None) -> float:
        """Return the time in which the stars move by a streak; 0 where it is not their motion."""
        if streak is None or not self.agrees(streak):
            return 0.0
        exposure_s = abs(self._seconds(streak))
        return exposure_s if exposure_s < MAX_EXPOSURE * self.interval_s else 0.0

    def agrees(self, streak: Streak) -> bool:
        """Return whether a streak of the image, whose sign is unknown, lies along the motion."""
        seen = _motion_px(streak)
        limit_px = max(MAX_ASTRAY * float(np.linalg.norm(seen)), MAX_ASTRAY_PX)
        along = self._seconds(streak) * _motion_px(self.motion)
        return bool(np.linalg.norm(seen - along) < limit_px)

    def _seconds(self, streak: Streak) -> float:
        """Return the time in which the motion comes nearest to a streak, or its opposite."""
        moved = _motion_px(self.motion)
        return float(_motion_px(streak) @ moved) / max(float(moved @ moved), 1e-9)


@compiled
def _windows_at(dt_s: float, uv: np.ndarray, velocity: np.ndarray, sigma_px: np.ndarray,
                stars: int) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Return the positions (K, 2) px and radii (K,) px of the windows after dt_s seconds.

    They are those of stars, then of targets that a window reaches. The last result is the
    speed of the fastest star in px/s.
    """
    after, radius_px = np.empty((len(uv), 2)), np.empty(len(uv))
    count, square = 0, 0.0
    for i in range(len(uv)):
        radius = GATE_SIGMAS * sigma_px[i] + GATE_PX
        if i < stars:
            radius = min(radius, MAX_GATE_PX)
            square = max(square, velocity[i, 0] ** 2 + velocity[i, 1] ** 2)
        if radius <= MAX_TARGET_PX:
            for axis in range(2):
                after[count, axis] = uv[i, axis] + velocity[i, axis] * dt_s
            radius_px[count] = radius
            count += 1
    return after[:count], radius_px[:count], math.sqrt(square)


@compiled
def _count_near(expected: np.ndarray, uv: np.ndarray, radius_px: float) -> int:
    """Return how many of pixels (K, 2) have another one of uv (N, 2) within a radius."""
    count = 0
    for i in range(len(expected)):
        for j in range(len(uv)):
            u, v = uv[j, 0] - expected[i, 0], uv[j, 1] - expected[i, 1]
            if u * u + v * v < radius_px * radius_px:
                count += 1
                break
    return count


class ExtractionStage:
    """
    Extracts the centroids of images, near the predictions of a star tracker where it has any.

    The exposure time is that of the options, else that given with an image, else learnt from the
    length of the streaks in the images that are searched: the mean of many, by the lengths. A
    streak that the motion does not explain and that is the same in two images is the shape of the
    stars: an astigmatic lens draws it, however the camera moves.
    windowed is whether the last image was not searched as a whole.
    """

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 search: SearchOptions = SearchOptions()) -> None:
        self.extractor = CentroidExtractor(options)
        self._line_time_s = options.line_time_us * 1e-6
        self._given_exposure_s = options.exposure_s
        self._search_period_ns = round(search.search_period_s * 1e9)
        self._max_stars = options.max_stars
        self._max_stars_lost = max(search.max_stars_lost, options.max_stars)
        self.reset()

    def reset(self) -> None:
        """Forget the images before: the next one is searched as a whole."""
        self.windowed = False
        self._searched: Searched | None = None
        self._stamp_ns = 0
        self._searched_ns: int | None = None
        self._seen_share = 1.0
        self._exposure = Exposure(self._given_exposure_s)
        self._point_speed_px_s = 0.0
        self._shape: Streak | None = None
        self._unexplained: Streak | None = None
        self._start: Extraction | None = None
        self._unpredicted = self._astray = 0
        self._narrow = False
        self._stale_rows = StaleRows()

    def process(self, stamp_ns: int, image: np.ndarray,
                predicted: PredictedCentroids | None = None, lost: bool = True,
                cell: int = 1, exposure_s: float = 0.0) -> Extraction:
        """
        Return the stars of image (H, W) uint8 or uint16 of a time, and its exposure.

        exposure_s is what the camera says of it, 0 where it says nothing: what it said last holds.

        Without lost, that there is no prediction does not mean that no star tracker tracks. Where
        each pixel of the image is cell x cell pixels of the camera, predictions and positions are
        in those of the camera, widths in those of the image.
        """
        if exposure_s and not self._given_exposure_s:
            self._exposure = Exposure(exposure_s)
        extraction = self._extract(
            stamp_ns, image, None if predicted is None else predicted.in_cells(cell), lost)
        centroids = replace(extraction.centroids, exposure_s=self.exposure_s)
        return replace(extraction, centroids=centroids.of_cells(cell),
                       rejected_uv=cell * extraction.rejected_uv + (cell - 1) / 2)

    @property
    def exposure_s(self) -> tuple[float, float]:
        """Return the least and the largest exposure by the streaks and points seen so far."""
        if self._exposure.seconds:
            return self._exposure.limits_s
        if self._point_speed_px_s:
            return 0.0, POINT_PX / self._point_speed_px_s
        return UNKNOWN_EXPOSURE

    def _extract(self, stamp_ns: int, image: np.ndarray, predicted: PredictedCentroids | None,
                 lost: bool) -> Extraction:
        """Return what process() does, without the exposure."""
        first, last = self._stale_rows.find(image)
        repeated = last - first == len(image) - 1
        interval_s, self._stamp_ns = (stamp_ns - self._stamp_ns) * 1e-9, stamp_ns
        self.windowed = False
        if last and not repeated:
            return _refused('torn', f'the rows {first} to {last} are those of the frame before: '
                            'a torn frame')
        if repeated and self._stale_rows.vary:
            return _refused('repeated', 'the image is that of the frame before, with its noise')
        if 0 < interval_s < self._line_time_s * len(image):
            return _refused('readout', f'read-out of {self._line_time_s * len(image):.3g} s, but '
                            f'{interval_s:.3g} s since the frame before: is line_time_us right?')
        if (predicted is None or predicted.stars < LEAST_PREDICTED
                or not 0 < stamp_ns - predicted.stamp_ns <= MAX_AGE_S * 1e9):
            self._searched_ns = None
            self._start = self._extract_unpredicted(image, lost)
            return self._start
        self._unpredicted = 0
        expected = _Expected.at(stamp_ns, predicted, image.shape, interval_s)
        if self._start is not None:
            self._learn_shown(self._start, expected)
            self._start = None
        moved_px = expected.speed_px_s * (stamp_ns - predicted.stamp_ns) * 1e-9
        if repeated and moved_px > REPEATED_PX:
            return _refused('repeated', 'the image is that of the frame before, though the stars '
                            f'have moved {moved_px:.1f} px')
        streak, shown = self._streaks(expected)
        unknown = (self._exposure.seconds == 0 and moved_px > SHORTEST_PX
                   and expected.speed_px_s > FASTER * self._point_speed_px_s)
        near = None if unknown else self._near(image, expected, shown)
        if near is not None and _contradicts(near):
            near = None
        if (near is not None and not expected.anywhere and not self._is_due(stamp_ns)
                and self._has_stars(near, expected)):
            self.windowed = True
            return near
        self._searched_ns = stamp_ns
        before, known = self._searched, None if unknown else streak
        searched = self._search(image, known)
        if _contradicts(searched):
            # The motion has changed since the prediction: the image shows which it is.
            searched, known, near = self._search(image), None, None
            unknown = moved_px > SHORTEST_PX
        astray = False
        if known is None or known.longest_px() < SHORTEST_PX:
            self._learn_shown(searched, expected)
            if self._shape is not None:
                near = None
            else:
                astray = (unknown and searched.streak is not None
                          and not expected.agrees(searched.streak))
        self._astray = self._astray + 1 if astray else 0
        # Without stars a prediction never changes: in the end it is what is wrong.
        if 0 < self._astray <= MAX_ASTRAY_IMAGES:
            return _refused('streak', f'streaks of {searched.streak_px:.1f} px in another '
                            'direction than the stars move')
        if near is not None and before is not None and self._searched is not None:
            contamination = self._searched.contamination
            if (expected.stars_seen(searched.centroids)
                    < LEAST_SHARE * expected.stars_seen(near.centroids)):
                # What fills the list is of another width: debris, which is no measure of stars.
                self._searched = before._replace(contamination=contamination)
            if contamination != before.contamination:
                near = self._near(image, expected, shown)
        return self._joined(image, searched, near, expected, known)

    def _streaks(self, expected: _Expected) -> tuple[Streak, Streak]:
        """Return the streak by motion and shape of the stars, and that near the predictions."""
        streak = expected.motion.scaled(self._exposure.seconds)
        if self._shape is not None:
            streak = self._shape.joined(streak)
        elif self._unexplained is not None:
            # The width of the stars in that image is the one across its streak.
            return streak, self._unexplained.joined(streak)
        return streak, streak

    def _extract_unpredicted(self, image: np.ndarray, lost: bool) -> Extraction:
        """Return the stars of an image: more of them, the longer the star tracker is lost."""
        self._unpredicted *= lost
        doublings = min(self._unpredicted // IMAGES_TO_ACQUIRE, 10)
        if not self._unpredicted % IMAGES_TO_ACQUIRE:
            # What is wide may be debris out of focus: every other time the narrowest are used.
            self._narrow = not self._narrow and self._unpredicted > 0 and (
                self._start is not None and self._start.psf_sigma_px > WIDE_PX)
        self._unpredicted += 1
        return self._search(image, None, min(self._max_stars << doublings, self._max_stars_lost),
                            self._narrow)

    def _search(self, image: np.ndarray, streak: Streak | None = None, most_stars: int = 0,
                narrow: bool = False) -> Extraction:
        """Return the stars of the whole image."""
        extraction, self._searched = self.extractor.search(
            image, streak, self._searched, most_stars=most_stars, points_only=narrow,
            narrow=narrow)
        return extraction

    def _near(self, image: np.ndarray, expected: _Expected, streak: Streak) -> Extraction | None:
        """Measure stars and targets near where they are expected."""
        if self._searched is None or not self._searched.fits(image):
            return None
        extraction, self._searched = self.extractor.search_near(
            image, expected.uv, expected.radius_px, self._searched, streak)
        return extraction

    def _has_stars(self, near: Extraction, expected: _Expected) -> bool:
        """Return whether as many of the predicted stars are seen as in the image searched last."""
        return expected.stars_seen(near.centroids) >= max(
            LEAST_PREDICTED, LEAST_SHARE * self._seen_share * expected.stars)

    def _joined(self, image: np.ndarray, extraction: Extraction, near: Extraction | None,
                expected: _Expected, streak: Streak | None) -> Extraction:
        """Return the stars of a searched image; what was measured near the predictions stays."""
        if near is None or expected.stars_seen(near.centroids) < max(
                LEAST_PREDICTED, LEAST_SHARE * expected.stars_seen(extraction.centroids)):
            if len(extraction.centroids) < LEAST_PREDICTED and self._exposure.seconds:
                extraction, streak = self._search(image), None
            self._learn(extraction, expected, streak)
            return extraction
        self._learn(near, expected, near.streak)
        stars, others = near.centroids, extraction.centroids
        if len(others):
            distance = np.linalg.norm(others.uv[:, None] - stars.uv, axis=-1).min(axis=1)
            stars = stars.joined(others.select(distance > SAME_PX))
        return replace(extraction, centroids=stars, status='ok', reason='', streak=near.streak)

    def _is_due(self, stamp_ns: int) -> bool:
        """Return whether it is time to search a whole image."""
        return (not self._search_period_ns or self._searched_ns is None
                or not 0 <= stamp_ns - self._searched_ns < self._search_period_ns)

    def _learn(self, extraction: Extraction, expected: _Expected, streak: Streak | None) -> None:
        """Learn from stars that were measured with this streak, None where it was not known."""
        if len(extraction.centroids) < LEAST_PREDICTED:
            return
        self._seen_share = expected.stars_seen(extraction.centroids) / expected.stars
        if extraction.streak is None or (
                self._shape is not None and not self._exposure.seconds):
            self._point_speed_px_s = max(self._point_speed_px_s, expected.speed_px_s)
        else:
            self._learn_exposure(extraction, expected)

    def _learn_shown(self, extraction: Extraction, expected: _Expected) -> None:
        """Learn exposure time and shape of the stars from the streak that an image shows."""
        shown, before = extraction.streak, self._unexplained
        if shown is not None and extraction.centroids.correlated_error.any():
            return
        self._shape = self._unexplained = None
        if shown is None or expected.exposure_s(shown):
            self._learn_exposure(extraction, expected)
            return
        self._unexplained = shown
        if before is not None and shown.is_close(before):
            # A time that was learnt from the shape of the stars is none.
            self._shape = shown
            if not self._exposure.is_given:
                self._exposure = Exposure(0.0)

    def _learn_exposure(self, extraction: Extraction, expected: _Expected) -> None:
        """
        Learn the exposure time from a streak that the image shows; few stars may err.

        An image of motion that is not uniform shows no time.
        """
        if extraction.centroids.correlated_error.any():
            return
        exposure_s = expected.exposure_s(extraction.streak)
        if exposure_s:
            self._exposure.add(exposure_s, len(extraction.centroids) * extraction.streak_px ** 2)


class Exposure:
    """
    The exposure time of the images, 0 s while unknown.

    Where it is not given it is the mean of what EXPOSURE_IMAGES have shown, with their weights;
    one that differs by EXPOSURE_CHANGED begins a new mean, if it has half of the weight of the
    others.
    """

    def __init__(self, given_s: float) -> None:
        self.seconds = given_s
        self.is_given = given_s > 0
        self._weight = self._images = self._scatter = 0.0

    @property
    def limits_s(self) -> tuple[float, float]:
        """Return the least and the largest exposure that it may be."""
        doubt = 0.0
        if not self.is_given:
            doubt = max(EXPOSURE_DOUBT, 2 * math.sqrt(self._scatter)) / math.sqrt(self._images)
        return (1 - doubt) * self.seconds, (1 + doubt) * self.seconds

    def add(self, exposure_s: float, weight: float) -> None:
        """Add what the streaks of an image show, with the inverse of its variance as weight."""
        if self.is_given:
            return
        change = exposure_s / self.seconds - 1 if self.seconds else math.inf
        if abs(change) > EXPOSURE_CHANGED:
            if weight >= self._weight / max(self._images, 1.0) / 2:
                self.seconds, self._weight, self._images, self._scatter = (
                    exposure_s, weight, 1.0, 0.0)
            return
        kept = 1 - 1 / EXPOSURE_IMAGES
        self._images = kept * self._images + 1
        self._weight = kept * self._weight + weight
        share = weight / self._weight
        self.seconds *= 1 + share * change
        self._scatter += share * (change ** 2 - self._scatter)


def _contradicts(extraction: Extraction) -> bool:
    """Return whether most spots are no streaks of the motion that was assumed."""
    return extraction.rejected.get('not_streaked', 0) > len(extraction.centroids)


def _refused(status: str, reason: str) -> Extraction:
    """Return the extraction of an image whose stars are not used."""
    return Extraction(Centroids.empty(), status, reason)


def _motion_px(streak: Streak) -> np.ndarray:
    """Return the motion (3,) of the middle of an image in px, and of its corner by the roll."""
    return np.array([streak.u_px, streak.v_px, np.hypot(streak.u0, streak.v0) * streak.roll])


class StaleRows:
    """
    Compares each image with the one before; two exposures never have the same noise.

    vary is whether two images in turn have differed in each row that has noise: one that is shown
    again and again from the start is no fault.
    """

    def __init__(self) -> None:
        self.vary = False
        self._before, self._spare = np.empty((0, 0)), np.empty((0, 0))
        self._pixels = np.empty((0, 0))

    def find(self, image: np.ndarray) -> tuple[int, int]:
        """
        Return the first and the last row that equal those of the image before; (0, 0) if none.

        They are the upper part of the image, the lower part, or all of it. Equal rows between
        others are no torn frame: the noise of such images, drawn or compressed, says nothing.
        """
        step = max(1, len(image) // COMPARED)
        first = max(0, (image.shape[1] - COMPARED_COLUMNS) // 2)
        rows = image[::step, first:first + COMPARED_COLUMNS]
        if self._before.shape != rows.shape or self._before.dtype != rows.dtype:
            self._before, self._spare = rows.copy(), np.empty_like(rows)
            self._pixels = rows[:, ::COMPARED_PX].copy()
            return 0, 0
        # Memory that was used before: a new block of this size would be mapped anew.
        sample, before = self._spare, self._before
        np.copyto(sample, rows)
        self._before, self._spare = sample, before
        # Few pixels first, side by side in memory.
        pixels = sample[:, ::COMPARED_PX].copy()
        alike, self._pixels = (pixels == self._pixels).all(axis=1), pixels
        if not alike.any() or not (sample[alike] == before[alike]).all(axis=1).any():
            self.vary = True
            return 0, 0
        noisy = np.flatnonzero(np.mean(
            sample != np.median(sample, axis=1, keepdims=True), axis=1) >= LEAST_NOISY)
        stale = (sample[noisy] == before[noisy]).all(axis=1)
        changes = int(np.count_nonzero(stale[1:] != stale[:-1]))
        if len(noisy) < LEAST_ROWS * len(sample):
            return 0, 0
        self.vary |= not stale.any()
        if not stale.any() or changes > 1:
            return 0, 0
        rows = noisy[stale] * step
        return int(rows[0]), len(image) - 1 if stale[-1] else int(rows[-1])
