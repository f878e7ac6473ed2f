"""Files that solve writes for each image."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from startracker_ros.camera.images import Photograph
from startracker_ros.camera.sip import fit_sip, wcs_header
from startracker_ros.pipeline.annotate import annotate, Labels
from startracker_ros.pipeline.sky_mapping import SkyMapping
from startracker_ros.pipeline.sky_marks import mark_bodies, mark_named_stars, mark_scale
from startracker_ros.pipeline.solution import Solution


@dataclass(frozen=True)
class Outputs:
    """Folders of annotated pictures and of FITS headers, None for no such files."""

    annotate_folder: Path | None = None
    wcs_folder: Path | None = None

    def write(self, name: str, photograph: Photograph, solution: Solution, year: float) -> None:
        """Write the files of one image of a Julian year under a name without a suffix."""
        if self.annotate_folder is not None:
            picture = annotated(photograph.image, solution, year)
            self.annotate_folder.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(self.annotate_folder / f'{name}.png'), picture[..., ::-1])
        if self.wcs_folder is not None and solution.sky is not None:
            self.wcs_folder.mkdir(parents=True, exist_ok=True)
            (self.wcs_folder / f'{name}.wcs').write_bytes(
                image_wcs(solution.sky, photograph.bottom_up))


def annotated(image: np.ndarray, solution: Solution, year: float) -> np.ndarray:
    """Return an image (H, W) as (H, W, 3) uint8 RGB with what is in it, and where north is."""
    labels, hip = Labels(image.shape), solution.identification.hip
    # Names come first, so that no number covers them.
    overlay = np.zeros((*image.shape, 3), np.uint8)
    if solution.sky is not None:
        mark_bodies(overlay, solution.bodies, labels)
        mark_named_stars(overlay, solution.sky, year, hip, labels)
        mark_scale(overlay, solution.sky, labels.size)
    return np.maximum(annotate(image, solution.centroids.uv, hip, labels=labels), overlay)


def image_wcs(sky: SkyMapping, bottom_up: bool = False) -> bytes:
    """Return the FITS header of an image; bottom_up for a file that has the lowest row first."""
    camera = sky.camera
    centre = np.array([camera.cx, camera.cy])
    # One map is the inverse of itself.
    sign, shift = ([1.0, -1.0], [0.0, camera.height - 1.0]) if bottom_up else (
        [1.0, 1.0], [0.0, 0.0])
    sip = fit_sip(lambda pixels: sky.directions(pixels * sign + shift), camera.width,
                  camera.height, centre * sign + shift)
    return wcs_header(sip, camera.width, camera.height)


def output_names(paths: Sequence[Path]) -> list[str]:
    """Return a name of the files for each image, numbered where several have the same."""
    used: Counter[str] = Counter()
    names = []
    for path in paths:
        used[path.stem] += 1
        number = used[path.stem]
        names.append(path.stem if number == 1 else f'{path.stem}-{number}')
    return names
