"""Attitude of single images: extraction, identification, pointing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import time

import cv2
import numpy as np
from startracker_ros.astro.epoch import epoch_year_now
from startracker_ros.astro.observer_motion import AT_REST, Observer
from startracker_ros.camera.images import calibrated_camera, ImageError, read_image_with_camera
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.catalog.deep import camera_catalog
from startracker_ros.catalog.onboard import onboard_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.extraction import CentroidExtractor
from startracker_ros.identify.identification import (
    Identification, IdentificationOptions, Identifier)
from startracker_ros.identify.methods import make_identifier
from startracker_ros.maths.rotation import ARCSEC, pointing_from_quaternion
from startracker_ros.pipeline.annotate import annotate
from startracker_ros.pipeline.icrf import icrf_identification
from startracker_ros.table import Result


@dataclass(frozen=True)
class Solution:
    """What one image shows; camera has the fitted focal length where identified."""

    centroids: Centroids
    identification: Identification
    camera: Camera

    @property
    def quaternion(self) -> np.ndarray | None:
        """q_icrf_from_sensor (4,), None without an attitude."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.quaternion


def solve_image(image: np.ndarray, extractor: CentroidExtractor, identifier: Identifier,
                sky: ApparentCatalog) -> Solution:
    """Return the attitude of one image (H, W) uint8 or uint16, or why there is none."""
    centroids = extractor.extract(image).centroids
    identification = icrf_identification(
        identifier.identify(centroids), centroids, identifier.camera, sky, identifier.options)
    return Solution(centroids, identification,
                    identifier.camera.with_focal_ratio(identification.focal_ratio))


def solve_files(paths: Sequence[Path], *, fov_deg: float | None = None,
                camera_file: Path | None = None, epoch_year: float | None = None,
                observer: Observer = AT_REST, annotate_folder: Path | None = None,
                options: IdentificationOptions = IdentificationOptions()) -> Result:
    """
    Solve image files with an ideal camera of fov_deg or the one of camera_file.

    epoch_year None is today; observer is how the camera moved then. CameraError for an impossible
    camera; an unreadable image is a row of its own.
    """
    if epoch_year is None:
        epoch_year = epoch_year_now()
    calibrated = calibrated_camera(camera_file, fov_deg)
    extractor = CentroidExtractor()
    identifiers: dict[Camera, tuple[Identifier, ApparentCatalog]] = {}
    rows = []
    for path in paths:
        try:
            image, camera = read_image_with_camera(path, calibrated, fov_deg)
            if camera not in identifiers:
                sky = ApparentCatalog(
                    onboard_catalog(camera_catalog(camera), camera, epoch_year))
                sky.look_from(observer)
                identifiers[camera] = make_identifier(camera, epoch_year, options), sky
            start_s = time.perf_counter()
            solution = solve_image(image, extractor, *identifiers[camera])
            rows.append(_row(path, solution, 1e3 * (time.perf_counter() - start_s)))
        except ImageError as error:
            rows.append({**_row(path, None, float('nan')), 'reason': str(error)})
            continue
        if annotate_folder is not None:
            annotate_folder.mkdir(parents=True, exist_ok=True)
            picture = annotate(image, solution.centroids.uv, solution.identification.hip)
            cv2.imwrite(str(annotate_folder / f'{path.stem}.png'), picture[..., ::-1])
    return Result('solve', rows, {'epoch': epoch_year, 'aberration': observer.condition})


def _row(path: Path, solution: Solution | None, solve_ms: float) -> dict[str, object]:
    names = ('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg', 'residual_arcsec')
    row = {'file': path.name, 'solved': False, **dict.fromkeys(names, float('nan')), 'matched': 0,
           'solve_ms': solve_ms, 'reason': ''}
    if solution is None:
        return row
    identification = solution.identification
    row['reason'] = identification.reason
    if identification.attitude is not None:
        residual_rad = identification.attitude.residual_rad
        pointing = np.degrees(pointing_from_quaternion(identification.attitude.quaternion))
        row.update(dict(zip(names, (*pointing, np.degrees(solution.camera.fov_x_rad),
                                    np.sqrt(np.mean(residual_rad ** 2)) / ARCSEC))),
                   solved=True, matched=identification.matched)
    return row
