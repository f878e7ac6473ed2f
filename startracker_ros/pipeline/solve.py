"""Attitude of image files: extraction, identification, pointing."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
import sys
import time

import numpy as np
from startracker_ros.astro.epoch import epoch_year_now
from startracker_ros.astro.observer_motion import AT_REST, Observer
from startracker_ros.camera.images import (
    calibrated_camera, ImageError, read_image_and_field, read_image_with_camera)
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.catalog.deep import camera_catalog
from startracker_ros.catalog.onboard import onboard_catalog
from startracker_ros.centroid.extraction import CentroidExtractor
from startracker_ros.identify.blind import LIKELY_DEG
from startracker_ros.identify.identification import IdentificationOptions, Identifier
from startracker_ros.identify.methods import make_identifier
from startracker_ros.maths.rotation import ARCSEC, pointing_from_quaternion
from startracker_ros.pipeline.annotate import picture_names, save_annotated
from startracker_ros.pipeline.icrf import icrf_identification
from startracker_ros.pipeline.photograph import PhotographSolver
from startracker_ros.pipeline.solution import MIN_STARS, Solution
from startracker_ros.table import Result

Solve = Callable[[np.ndarray], Solution]

DETAILS = ('path', 'status', 'quaternion', 'covariance_sensor', 'false_alarm_probability',
           'detected', 'lens')
"""Columns that are too wide for the terminal."""


def solve_image(image: np.ndarray, extractor: CentroidExtractor, identifier: Identifier,
                sky: ApparentCatalog) -> Solution:
    """Return the attitude of one image (H, W) of a calibrated camera, or why there is none."""
    extraction = extractor.extract(image)
    centroids = extraction.centroids
    if len(centroids) < MIN_STARS:
        return Solution.none(identifier.camera, centroids, extraction.status, extraction.reason)
    identification = icrf_identification(
        identifier.identify(centroids), centroids, identifier.camera, sky, identifier.options)
    return Solution(centroids, identification,
                    identifier.camera.with_focal_ratio(identification.focal_ratio))


def solve_files(paths: Sequence[Path], *, fov_deg: float | None = None,
                camera_file: Path | None = None, epoch_year: float | None = None,
                observer: Observer = AT_REST, annotate_folder: Path | None = None,
                options: IdentificationOptions = IdentificationOptions()) -> Result:
    """
    Solve image files of the camera of camera_file, or of an uncalibrated one of fov_deg.

    The lens of the latter is fitted to each image. Without both, EXIF has the field of view or
    all from 1 to 120 deg are searched. epoch_year None is today; observer is how the
    camera moved then. CameraError for an impossible camera; an unreadable image is a row of its
    own.
    """
    if epoch_year is None:
        epoch_year = epoch_year_now()
    blind = fov_deg is None and camera_file is None
    calibrated = None if blind else calibrated_camera(camera_file, fov_deg)
    any_field = PhotographSolver(None, epoch_year, options, observer) if blind else None
    solvers: dict[Camera, Solve] = {}
    rows = []
    for path, name in zip(_progress(paths), picture_names(paths)):
        try:
            if any_field is None:
                image, camera = read_image_with_camera(path, calibrated, fov_deg)
            else:
                image, exif_deg = read_image_and_field(path)
        except ImageError as error:
            rows.append({**_row(path, None, float('nan')), 'status': 'unreadable',
                         'reason': str(error)})
            continue
        solve: Solve
        if any_field is not None:
            solve = partial(any_field.solve, likely_deg=exif_deg or LIKELY_DEG)
        else:
            if camera not in solvers:
                solvers[camera] = _solver(camera, calibrated is not None, epoch_year, options,
                                          observer)
            solve = solvers[camera]
        start_s = time.perf_counter()
        solution = solve(image)
        rows.append(_row(path, solution, 1e3 * (time.perf_counter() - start_s)))
        if annotate_folder is not None:
            save_annotated(annotate_folder / name, image, solution.centroids.uv,
                           solution.identification.hip)
    return Result('solve', rows, {'epoch': epoch_year, 'aberration': observer.condition},
                  DETAILS)


def _solver(camera: Camera, calibrated: bool, epoch_year: float, options: IdentificationOptions,
            observer: Observer) -> Solve:
    """Return what solves the images of a camera."""
    if not calibrated:
        return PhotographSolver(camera, epoch_year, options, observer).solve
    extractor, identifier = CentroidExtractor(), make_identifier(camera, epoch_year, options)
    sky = ApparentCatalog(onboard_catalog(camera_catalog(camera), camera, epoch_year))
    sky.look_from(observer)
    return lambda image: solve_image(image, extractor, identifier, sky)


def _progress(paths: Sequence[Path]) -> Iterable[Path]:
    """Return the paths, with a progress bar on a terminal where there are several."""
    from rich.console import Console
    from rich.progress import track
    if len(paths) < 2 or not sys.stderr.isatty():
        return paths
    return track(paths, 'solve', console=Console(stderr=True), transient=True)


def _row(path: Path, solution: Solution | None, solve_ms: float) -> dict[str, object]:
    nothing = dict.fromkeys(('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg', 'residual_arcsec'),
                            float('nan'))
    row = {'file': path.name, 'solved': False, **nothing, 'matched': 0, 'solve_ms': solve_ms,
           'reason': '', **dict.fromkeys(DETAILS), 'path': str(path)}
    if solution is None:
        return row
    found, camera = solution.identification, solution.camera
    row.update(reason=found.reason, status=found.status, detected=len(solution.centroids),
               false_alarm_probability=found.false_alarm_probability)
    if found.attitude is not None:
        ra_deg, dec_deg, roll_deg = np.degrees(
            pointing_from_quaternion(found.attitude.quaternion))
        rms_rad = np.sqrt(np.mean(found.attitude.residual_rad ** 2))
        row.update(solved=True, ra_deg=ra_deg, dec_deg=dec_deg, roll_deg=roll_deg,
                   fov_deg=np.degrees(camera.seen_x_rad), residual_arcsec=rms_rad / ARCSEC,
                   matched=found.matched, quaternion=found.attitude.quaternion.tolist(),
                   covariance_sensor=found.attitude.covariance_sensor.ravel().tolist(),
                   lens={'fx': camera.fx, 'fy': camera.fy, 'cx': camera.cx, 'cy': camera.cy,
                         'distortion': list(camera.distortion)})
    return row
