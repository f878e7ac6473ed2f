"""Which images are searched as a whole, and in which only the predicted stars are measured."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.centroid.extraction import (
    CentroidExtractor, Extraction, ExtractionOptions)
from startracker_ros.centroid.prediction import PredictedStars
from startracker_ros.centroid.streak import SHORTEST_PX, Streak
from startracker_ros.options import option, Options

LEAST_PREDICTED = 4
LEAST_SHARE = 0.75  # of the predicted stars that were seen in the image searched last
MAX_AGE_S = 1.0  # of a prediction
GATE_SIGMAS = 4.0
GATE_PX = 2.0  # for accelerations that a prediction does not know
MAX_GATE_PX = 8.0
FASTER = 2.0  # times the speed at which stars were points: they may be streaks


@dataclass(frozen=True)
class SearchOptions(Options):
    """How often an image is searched as a whole."""

    search_period_s: float = option(
        1.0, 'time between two images that are searched as a whole while the star tracker '
        'predicts where its stars are; in the others only these are measured; 0: every image '
        'is searched', unit='s', low=0.0, high=3600.0)


class ExtractionStage:
    """
    Extracts the centroids of images, near the predictions of a star tracker where it has any.

    The exposure time is learnt from the length of the streaks in the images that are searched.
    directed is whether the last image was not searched as a whole.
    """

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 search: SearchOptions = SearchOptions()) -> None:
        self.extractor = CentroidExtractor(options)
        self._search_period_ns = round(search.search_period_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Search the next image as a whole."""
        self.directed = False
        self._searched_ns: int | None = None
        self._seen_share = 1.0
        self._exposure_s = 0.0
        self._point_speed_px_s = 0.0

    def extract(self, stamp_ns: int, image: np.ndarray, predicted: PredictedStars | None = None
                ) -> Extraction:
        """Return the stars of image (H, W) uint8 or uint16 of a time."""
        usable = (predicted is not None and len(predicted) >= LEAST_PREDICTED
                  and 0 < stamp_ns - predicted.stamp_ns <= MAX_AGE_S * 1e9)
        self.directed = False
        if not usable or predicted is None:
            self._searched_ns = None
            return self.extractor.extract(image)
        uv, speed_px_s = predicted.at(stamp_ns), float(np.hypot(*predicted.velocity.T).max())
        streak = predicted.streak(self._exposure_s, image.shape)
        interval_s = (stamp_ns - predicted.stamp_ns) * 1e-9
        unknown = (self._exposure_s == 0 and speed_px_s * interval_s > SHORTEST_PX
                   and speed_px_s > FASTER * self._point_speed_px_s)
        if not self._is_due(stamp_ns) and not unknown:
            radius_px = np.minimum(GATE_SIGMAS * predicted.sigma_px + GATE_PX, MAX_GATE_PX)
            extraction = self.extractor.extract_near(image, uv, radius_px, streak)
            if extraction is not None and len(extraction.centroids) >= max(
                    LEAST_PREDICTED, LEAST_SHARE * self._seen_share * len(uv)):
                self.directed = True
                return extraction
        self._searched_ns = stamp_ns
        extraction = self.extractor.extract(image, None if unknown else streak)
        if len(extraction.centroids) < LEAST_PREDICTED and self._exposure_s:
            extraction = self.extractor.extract(image)
        self._learn(extraction, predicted, uv, streak, speed_px_s)
        return extraction

    def _is_due(self, stamp_ns: int) -> bool:
        """Return whether it is time to search a whole image."""
        return (not self._search_period_ns or self._searched_ns is None
                or not 0 <= stamp_ns - self._searched_ns < self._search_period_ns)

    def _learn(self, extraction: Extraction, predicted: PredictedStars, uv: np.ndarray,
               streak: Streak, speed_px_s: float) -> None:
        """Learn the exposure time, and the share of the predicted stars that are seen."""
        if len(extraction.centroids) < LEAST_PREDICTED:
            return
        distance = np.linalg.norm(uv[:, None] - extraction.centroids.uv, axis=-1).min(axis=1)
        self._seen_share = float(np.mean(distance < MAX_GATE_PX))
        if extraction.streak is None:
            self._exposure_s, self._point_speed_px_s = 0.0, speed_px_s
        elif extraction.streak is not streak:
            # The length in the middle, or with a roll alone that of the corner.
            once = predicted.streak(1.0, (1, 1))._replace(
                u0=extraction.streak.u0, v0=extraction.streak.v0)
            self._exposure_s = extraction.streak.longest_px() / max(once.longest_px(), 1e-9)
