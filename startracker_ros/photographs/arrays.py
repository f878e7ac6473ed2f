# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Single images: solve, extract, calibrate."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import epoch_year_now, julian_year
from startracker_ros.core.calibration.estimate import Calibration
from startracker_ros.core.camera.distortion import EQUIDISTANT, PLUMB_BOB
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.extraction import (
    CentroidExtractor, Extraction, ExtractionOptions)
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.options import options_by_class
from startracker_ros.io.images.dark import Dark, read_dark
from startracker_ros.io.images.images import (
    camera_of, Photograph, photograph_of, read_photograph)
from startracker_ros.photographs.calibrate import calibrate_lists, MAX_STARS
from startracker_ros.photographs.epoch_and_site import epoch_of, ObserverSite
from startracker_ros.photographs.solution import Solution
from startracker_ros.photographs.solve import (
    CALIBRATED_PERCENT, PHOTOGRAPH_LIMIT_S, Solvers, UNCALIBRATED_PERCENT)

Image = np.ndarray | str | Path
"""An array (H, W) or (H, W, 3) of colours, of integers or floats, or the path of a file."""


def solve(image: Image, fov_deg: float | None = None,
          epoch: float | datetime | str | None = None, fov_error_percent: float | None = None, *,
          camera: Camera | None = None, catalogue: str | Path | None = None,
          near_deg: tuple[float, float] | None = None, dark: Image | None = None,
          **options: Any) -> Solution:
    """
    Return attitude and lens of an image, as `startracker solve` does.

    fov_deg is the horizontal field of view; without it the file has it, or a search of all fields
    and of fisheyes. camera is a calibrated one instead. Both are within fov_error_percent,
    by default 5, of a calibrated camera 0.5. catalogue is a folder of `startracker catalogue`, for
    narrow fields; near_deg right ascension and declination of the image within 5 deg. dark is a
    dark frame of the same size, or a .txt or .csv file of bad pixels.
    epoch is the Julian year or the time, as 2019-07-29T20:47, UTC where it names no zone: without
    it that of the file, else today without aberration. Where a FITS file does not say the order of
    its rows and the image is mirrored, the result is that of the other order (turned_over).
    options are those of star_identifier (IdentificationOptions).
    ValueError for wrong options, images and cameras; an image without an attitude has a reason.
    """
    if fov_deg is not None and camera is not None:
        raise ValueError('give either fov_deg or camera')
    if camera is not None and catalogue is not None:
        raise ValueError('give either catalogue or camera: with a catalogue the lens is fitted')
    if near_deg is not None and catalogue is None:
        raise ValueError('near_deg is for a catalogue of narrow fields: give catalogue as well')
    if fov_error_percent is None:
        fov_error_percent = UNCALIBRATED_PERCENT if camera is None else CALIBRATED_PERCENT
    chosen = options_by_class((IdentificationOptions,), {
        'time_limit_s': PHOTOGRAPH_LIMIT_S, 'fov_error_percent': fov_error_percent,
        **options})[IdentificationOptions]
    assert isinstance(chosen, IdentificationOptions)
    photograph = _photograph(image)
    if dark is not None:
        photograph = (read_dark(dark) if isinstance(dark, (str, Path)) else
                      Dark('dark', _photograph(dark))).subtracted(photograph)
    when = epoch_of(_year(epoch), photograph.taken)
    site = ObserverSite()
    return _solvers(fov_deg, camera, chosen, catalogue).solve(
        _name(image), photograph, when, site.observer(when), site.bodies(when), near_deg)[0]


# The pattern databases of the newest cameras.
_solvers = lru_cache(maxsize=4)(Solvers)


def extract(image: Image, **options: Any) -> Extraction:
    """
    Return the stars of an image; options are those of centroid_extractor (ExtractionOptions).

    ValueError for a wrong option or image.
    """
    chosen = options_by_class((ExtractionOptions,), options)[ExtractionOptions]
    assert isinstance(chosen, ExtractionOptions)
    return CentroidExtractor(chosen).measure(_photograph(image).image)


def calibrate(images: Sequence[Image], fov_deg: float | None = None, *,
              camera: Camera | None = None, epoch: float | datetime | str | None = None,
              terms: Sequence[str] = (), distortion_model: str = PLUMB_BOB) -> Calibration:
    """
    Return the calibration of the camera of images, `frames` the indices of those that are used.

    It starts from fov_deg, within 5 %, or from a camera; a fisheye needs neither. epoch, without
    aberration if None, terms and distortion_model are as those of `startracker calibrate`.
    CalibrationError, a ValueError, where the images do not determine the camera.
    """
    unknown = fov_deg is None and camera is None
    if (unknown and distortion_model != EQUIDISTANT
            or fov_deg is not None and camera is not None):
        raise ValueError('give either fov_deg or camera')
    year, centroids = _year(epoch), {}
    for index, image in enumerate(images):
        pixels = _photograph(image).image
        camera = camera_of(_name(image, index), pixels, camera, fov_deg, distortion_model)
        centroids[index] = CentroidExtractor(
            ExtractionOptions(max_stars=MAX_STARS)).measure(pixels).centroids
    if camera is None or not centroids:
        raise ValueError('no images to calibrate from')
    observer = ObserverSite().observer(epoch_of(year))
    used, calibration = calibrate_lists(
        centroids, camera, epoch_year_now() if year is None else year, observer.state, terms, {})
    return replace(calibration, frames=np.array(sorted(used, key=used.__getitem__)))


def _photograph(image: Image) -> Photograph:
    if isinstance(image, (str, Path)):
        return read_photograph(image)
    return photograph_of(image)


def _name(image: Image, index: int | None = None) -> str:
    if isinstance(image, (str, Path)):
        return str(image)
    return 'image' if index is None else f'image {index}'


def _year(epoch: float | datetime | str | None) -> float | None:
    return None if epoch is None else julian_year(epoch)
