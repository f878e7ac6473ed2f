# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which images are searched as a whole, and in which only predicted centroids are measured."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.centroid.extraction import (
    CentroidExtractor, check_image, Extraction, ExtractionOptions, native_options)
from startracker_ros.core.centroid.image_tracker import ImageTracker
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class SearchOptions(Options):
    """How often an image is searched as a whole."""

    search_period_s: float = option(
        1.0, 'time between two images that are searched as a whole while the star tracker '
        'predicts where its stars are; in the others only these are measured; 0: every image '
        'is searched', unit='s', low=0.0, high=3600.0, live=True)
    max_stars_lost: int = option(
        160, 'maximum number of stars while the star tracker is lost: max_stars in the first '
        'two images, then twice as many in every further two, for stars among brighter detections',
        low=1, high=5000, live=True)


class ExtractionStage:
    """
    Extracts the centroids of images, near the predictions of a star tracker where it has any.

    The exposure time is that of the options, else that of the image, else estimated from the
    length of the streaks in the images that are searched: the mean of many, by the lengths. A
    streak that the motion does not explain and that is the same in two images is the shape of the
    stars: an astigmatic lens draws it, however the camera moves.
    windowed is whether the last image was not searched as a whole. options are the fields of
    st_extraction_options; images extracts by them.
    """

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 search: SearchOptions = SearchOptions()) -> None:
        self.images: ImageTracker | None = None
        self.windowed = False
        self.set_options(options, search)

    def set_options(self, options: ExtractionOptions, search: SearchOptions) -> None:
        """Use options of which only live ones differ from those before; nothing is forgotten."""
        self.extractor = CentroidExtractor(options)
        self.options = native_options(options) | {
            'search_period_s': search.search_period_s, 'max_stars_lost': search.max_stars_lost}
        if self.images is not None:
            self.images.change_options(self.options)

    def reset(self) -> None:
        """Forget the images before: the next one is searched as a whole."""
        self.windowed = False
        if self.images is not None:
            self.images.reset()

    def process(self, stamp_ns: int, image: np.ndarray,
                predicted: PredictedCentroids | None = None, lost: bool = True,
                cell: int = 1, exposure_s: float = 0.0) -> Extraction:
        """
        Return the stars of image (H, W) uint8 or uint16 of a time, and its exposure.

        exposure_s is what the camera says of it, 0 where it says nothing: what it said last holds.

        Without lost, that there is no prediction does not mean that no star tracker tracks. Where
        each pixel of the image is cell x cell pixels of the camera, predictions and positions are
        in those of the camera, widths in those of the image. An image of another camera resets
        the extractor.
        """
        check_image(image)
        if self.images is None or not self.images.is_of(image, cell):
            self.images = ImageTracker(
                (cell * image.shape[0], cell * image.shape[1]), self.options)
        found = self.images.extract(stamp_ns, image, predicted, lost, cell, exposure_s)
        self.windowed = bool(found.figures['windowed'])
        return Extraction.of(found)
