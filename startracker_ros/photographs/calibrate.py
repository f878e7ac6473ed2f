# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Calibration from image files: extraction, identification, camera YAML, result table."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from startracker_ros.core.astro.aberration import ObserverState
from startracker_ros.core.astro.epoch import epoch_year_now
from startracker_ros.core.astro.observer_motion import AT_REST, Observer
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.estimate import calibrate, Calibration, MIN_FRAME_STARS
from startracker_ros.core.calibration.matching import View
from startracker_ros.core.calibration.summary import figures, summary
from startracker_ros.core.camera.distortion import PLUMB_BOB
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.io.images.images import calibrated_camera, read_image_with_camera
from startracker_ros.io.several_files import OneOfSeveral
from startracker_ros.io.table import Result
from startracker_ros.photographs.blind import BlindIdentifier, LENS_ERROR
from startracker_ros.photographs.estimated_lens import estimate_lens
from startracker_ros.photographs.ladder import LadderIdentifier
from startracker_ros.photographs.unknown_lens import FISHEYES, UnknownLensIdentifier

# Stars in the corners are mostly faint.
MAX_STARS = 300
_PX = 'px', 'px, 1 sigma'
_OF_STARS = 'rms of the single stars, with the errors of their centroids'
_OF_LENS = 'rms of the lens alone: of the mean in each cell of the image'
_NOTES = {
    **{f'{name}{end}': unit for name in ('focal', 'fx', 'fy', 'cx', 'cy')
       for end, unit in zip(('', '_sigma'), _PX)},
    **{f'{name}_arcsec': _OF_STARS for name in ('pinhole', 'calibrated', 'left_out')},
    **{f'{name}_lens_arcsec': _OF_LENS for name in ('pinhole', 'calibrated', 'left_out')}}
# What is known of the field of view before the first image is solved.
_WIDE = IdentificationOptions(fov_error_percent=5.0)
# With the lens of one image; distortion beyond it changes the focal length from field to field.
_RATIO_ERROR = 0.02  # of the pixel sides as one image shows them
_REFINED = tuple(IdentificationOptions(fov_error_percent=1.0, sigma_floor_px=floor_px)
                 for floor_px in (0.5, 2.0))


def calibrate_files(paths: Sequence[Path], output: Path, *, fov_deg: float | None = None,
                    camera_file: Path | None = None, epoch_year: float | None = None,
                    observer: Observer = AT_REST, terms: Sequence[str] = (),
                    distortion_model: str = PLUMB_BOB) -> Result:
    """
    Calibrate the camera of image files and write it to output.

    The initial camera is that of camera_file or an ideal one of fov_deg and distortion_model with
    the size of the first readable image; a fisheye needs neither. epoch_year None is today;
    observer is how the camera moved then. The row of an unused image has the reason. CameraError
    for an impossible initial camera, CalibrationError when the images do not determine the camera,
    OSError when output cannot be written.
    """
    if epoch_year is None:
        epoch_year = epoch_year_now()
    camera = calibrated_camera(camera_file, fov_deg, distortion_model)
    extractor = CentroidExtractor(ExtractionOptions(max_stars=MAX_STARS))
    centroids: dict[int, Centroids] = {}
    reasons: dict[int, str] = {}
    for index, path in enumerate(paths):
        with OneOfSeveral(partial(reasons.__setitem__, index)):
            image, camera = read_image_with_camera(path, camera, fov_deg,
                                                   distortion_model)
            centroids[index] = extractor.measure(image).centroids
    if camera is None or not centroids:
        raise CalibrationError('; '.join(['no image to calibrate from', *reasons.values()]))
    try:
        used, calibration = calibrate_lists(centroids, camera, epoch_year, observer.state,
                                            terms, reasons)
    except CalibrationError as error:
        unused = [f'{paths[index].name}: {reason}' for index, reason in reasons.items()]
        raise CalibrationError('; '.join([str(error), *unused])) from error
    save_camera(calibration.camera, output)
    rows = [{'file': path.name, 'used': index in used,
             **figures(calibration, calibration.stars.frame == used.get(index, -1)),
             'reason': reasons.get(index, '')} for index, path in enumerate(paths)]
    return Result('calibrate', rows, {
        **summary(calibration), 'distortion_model': calibration.camera.distortion_model,
        'epoch': epoch_year, 'aberration': observer.condition, 'output': str(output)},
        notes=_NOTES)


def calibrate_lists(centroids: dict[int, Centroids], camera: Camera, epoch_year: float,
                    observer_state: ObserverState | None, terms: Sequence[str],
                    reasons: dict[int, str]) -> tuple[dict[int, int], Calibration]:
    """
    Return the frame number of each image in use and the calibration; add to reasons.

    centroids and reasons, why an image is not used, are by the number of the image.
    CalibrationError when the images do not determine the camera.
    """
    onboard = camera_stars(camera, epoch_year)
    views: dict[int, View] = {}
    estimated = _with_estimated_lens(centroids, camera, epoch_year)
    # Terms that are not free stay those of the initial camera.
    camera = camera.with_focal_ratio(estimated.fx / camera.fx) if terms else estimated
    for options in _REFINED:
        _identify(centroids, views, camera, epoch_year, options, reasons)
    calibration = calibrate(_seen_from(observer_state, views), camera, onboard, terms)
    used = _used(views, calibration)
    if len(views) < len(centroids):
        before = len(views)
        _identify_by_ladder(centroids, views, calibration.camera, epoch_year, reasons)
        if len(views) > before:
            for index, frame in used.items():
                views[index] = View(centroids[index], calibration.adjustment.quaternions[frame])
            calibration = calibrate(
                _seen_from(observer_state, views), calibration.camera, onboard, terms)
            used = _used(views, calibration)
    reasons.update({index: f'fewer than {MIN_FRAME_STARS} of its stars fit the camera'
                    for index in views if index not in used})
    return used, calibration


def _seen_from(observer_state: ObserverState | None, views: dict[int, View]) -> list[View]:
    """Return the views of a camera of that state."""
    return [replace(view, observer_state=observer_state) for view in views.values()]


def _used(views: dict[int, View], calibration: Calibration) -> dict[int, int]:
    """Return the frame number of each image that the calibration uses."""
    index = [*views]
    return {index[view]: frame for frame, view in enumerate(calibration.frames)}


def _with_estimated_lens(centroids: dict[int, Centroids], camera: Camera, epoch_year: float
                      ) -> Camera:
    """Return the lens of the first image that a search without a calibration solves."""
    shape = camera.height, camera.width
    ladder = LadderIdentifier(camera, epoch_year, _WIDE)
    searches = [(ladder.identify, _WIDE.fov_error_percent / 100)]
    if camera.model.equidistant:
        unknown = UnknownLensIdentifier(epoch_year, BlindIdentifier(epoch_year).wide_quads)
        searches.insert(0, (partial(unknown.identify, shape=shape, lenses=FISHEYES), LENS_ERROR))
    for image_centroids, (identify, focal_error) in product(centroids.values(), searches):
        for attempt in identify([image_centroids]):
            if attempt.identification.attitude is not None:
                lens = estimate_lens(attempt, focal_error)
                if not lens.rejected:
                    return _with_likely_ratio(lens.camera, camera.fy / camera.fx)
    return camera


def _with_likely_ratio(camera: Camera, given: float) -> Camera:
    """Return the camera with the given fy / fx, unless the fitted one is clearly another."""
    found = camera.fy / camera.fx
    if abs(found / given - 1) > _RATIO_ERROR:
        return camera
    focal = np.sqrt(camera.fx * camera.fy / given)
    return replace(camera, fx=float(focal), fy=float(focal * given))


def _identify_by_ladder(centroids: dict[int, Centroids], views: dict[int, View], camera: Camera,
                        epoch_year: float, reasons: dict[int, str]) -> None:
    """
    Add images to views that are identified with other tolerances or fainter stars.

    The brightest stars, which are searched first, may be those that the detector saturates.
    """
    ladder = LadderIdentifier(camera, epoch_year)
    for index in [index for index in centroids if index not in views]:
        for attempt in ladder.identify([centroids[index]]):
            if attempt.identification.attitude is not None:
                reasons.pop(index, None)
                views[index] = View(centroids[index],
                                    attempt.identification.attitude.quaternion)
                break


def _identify(centroids: dict[int, Centroids], views: dict[int, View], camera: Camera,
              epoch_year: float, options: IdentificationOptions, reasons: dict[int, str]) -> None:
    """Add identified images to views, and the reasons of the others to reasons."""
    rest = [index for index in centroids if index not in views]
    if not rest:
        return
    identifier = make_identifier(camera, epoch_year, options)
    for index in rest:
        identification = identifier.identify(centroids[index])
        if identification.attitude is None:
            reasons[index] = f'not identified: {identification.reason}'
            continue
        reasons.pop(index, None)
        views[index] = View(centroids[index], identification.attitude.quaternion)
