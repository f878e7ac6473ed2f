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
    Solve one image without a guess of its attitude, as `startracker solve` does.

    Args:
        image: Path of a file, or array (H, W) or (H, W, 3) of integers or floats, rows from the
            top. Where a FITS file does not say the order of its rows and the image is mirrored,
            the other order is solved (`Solution.turned_over`).
        fov_deg: Horizontal field of view, edge to edge, deg. Default: that of the file, else all
            fields from 0.6 to 120 deg are searched, then fisheyes.
        epoch: Julian year, datetime or text as `'2019-07-29T20:47:26Z'`, UTC without a zone.
            Default: the time in the file, else today without aberration.
        fov_error_percent: Tolerance of the focal length, 0 to 5 %. Default: 5, with `camera` 0.5.
        camera: Calibrated camera instead of `fov_deg`; its distortion is not fitted.
        catalogue: Folder that `startracker catalogue` wrote, for fields of 0.3 to 2 deg.
        near_deg: Right ascension and declination of the image, deg ICRS, within 5 deg; with
            `catalogue` only.
        dark: Dark frame to subtract, as `image`, or path of a .txt or .csv file of bad pixels.
        **options: Parameters of the node star_identifier, as `time_limit_s=10.0`.

    Returns:
        `Solution`; without an attitude its `solved` is False and its `reason` says why.

    Raises:
        CameraError: An impossible field of view.
        CatalogueError: No catalogue in the folder.
        ImageError: A file that cannot be read as an image, or not the size of `camera`.
        ValueError: A wrong argument or option; the three above are ValueErrors, too.

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
    Find the stars of one image.

    Args:
        image: Path of a file, or array (H, W) or (H, W, 3) of integers or floats.
        **options: Parameters of the node centroid_extractor, as `max_stars=100`.

    Returns:
        `Extraction` with the centroids, and why there are none.

    Raises:
        ImageError: A file that cannot be read as an image.
        ValueError: A wrong option, or an array of another kind.

    """
    chosen = options_by_class((ExtractionOptions,), options)[ExtractionOptions]
    assert isinstance(chosen, ExtractionOptions)
    return CentroidExtractor(chosen).measure(_photograph(image).image)


def calibrate(images: Sequence[Image], fov_deg: float | None = None, *,
              camera: Camera | None = None, epoch: float | datetime | str | None = None,
              terms: Sequence[str] = (), distortion_model: str = PLUMB_BOB) -> Calibration:
    """
    Calibrate a camera with images of stars, as `startracker calibrate` does.

    Args:
        images: Paths or arrays as of `solve()`, all of one size, two or more, of a fisheye one.
        fov_deg: Horizontal field of view within 5 %, deg; a fisheye needs none.
        camera: Camera to start from instead of `fov_deg`.
        epoch: Julian year, datetime or text, UTC without a zone. Default: today, without
            aberration.
        terms: What is estimated in addition to the focal length, of k1, centre, tangential, k2,
            k3 and k4. Default: what the stars show to be significant.
        distortion_model: `'plumb_bob'`, or `'equidistant'` for fisheyes of any projection.

    Returns:
        `Calibration`; its `camera` is the result, its `frames` are the indices of used images.

    Raises:
        CalibrationError: The images do not determine the camera.
        CameraError: An impossible field of view.
        ImageError: A file that cannot be read as an image, or an image of another size.
        ValueError: A wrong argument; the three above are ValueErrors, too.

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
