"""Files that solve writes for each image."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from startracker_ros.core.camera.sip import fit_sip, wcs_header
from startracker_ros.core.stages.annotate import annotate, Labels
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.stages.sky_marks import (
    mark_bodies, mark_figures, mark_named_stars, mark_scale)
from startracker_ros.core.stages.solution import Solution
from startracker_ros.io.images.images import Photograph
from startracker_ros.io.output import output_folder, write_output


@dataclass(frozen=True)
class Outputs:
    """Folders of annotated pictures and of FITS headers, None for no such files."""

    annotate_folder: Path | None = None
    wcs_folder: Path | None = None

    def write(self, name: str, photograph: Photograph, solution: Solution, year: float) -> None:
        """Write the files of one image of a Julian year under a name without a suffix."""
        if self.annotate_folder is not None:
            picture = annotated(photograph.image, solution.centroids.uv,
                                solution.identification.hip, solution.sky, year, solution.bodies)
            # In memory: OpenCV reports a full disk on stderr alone.
            content = cv2.imencode('.png', picture[..., ::-1])[1].tobytes()
            write_output(output_folder(self.annotate_folder) / f'{name}.png', content)
        if self.wcs_folder is not None and solution.sky is not None:
            write_output(output_folder(self.wcs_folder) / f'{name}.wcs',
                         image_wcs(solution.sky, photograph.mirrored, photograph.bottom_up))


def annotated(image: np.ndarray, uv: np.ndarray, hip: np.ndarray, sky: SkyMapping | None,
              year: float, bodies: tuple[BodyInImage, ...] = ()) -> np.ndarray:
    """
    Return an image (H, W) as (H, W, 3) uint8 RGB with what is in it, and where north is.

    uv (N, 2) are its spots, hip (N,) their Hipparcos numbers, 0 for none; sky is None where the
    attitude is unknown.
    """
    labels = Labels(image.shape)
    # Names come first, so that no number covers them.
    overlay = np.zeros((*image.shape, 3), np.uint8)
    if sky is not None:
        mark_figures(overlay, sky, year, labels.size)
        mark_bodies(overlay, bodies, labels)
        mark_named_stars(overlay, sky, year, hip, labels)
        mark_scale(overlay, sky, labels.size)
    return np.maximum(annotate(image, uv, hip, labels=labels), overlay)


def image_wcs(sky: SkyMapping, mirrored: bool = False, bottom_up: bool = False) -> bytes:
    """Return the FITS header of an image with columns and rows in the order of its file."""
    camera = sky.camera
    turned = np.array([mirrored, bottom_up])
    last = np.array([camera.width, camera.height]) - 1.0

    def other(pixels: np.ndarray) -> np.ndarray:
        """Return pixels of the file as those of the image, or the other way."""
        return np.where(turned, last - pixels, pixels)

    sip = fit_sip(lambda pixels: sky.directions(other(pixels)), camera.width, camera.height,
                  other(np.array([camera.cx, camera.cy])))
    return wcs_header(sip, camera.width, camera.height)
