# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that solve writes for each image."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import textwrap

import cv2
import numpy as np
from startracker_ros.core.stages.annotate import (
    annotate, BODY, FOUND, IDENTIFIED, Labels, mark_bodies)
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.images import Photograph
from startracker_ros.io.images.wcs_file import header_directions
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.photographs.sip import fit_sip, wcs_header
from startracker_ros.photographs.sky_marks import (
    mark_figures, mark_named_stars, mark_scale, NAMED)
from startracker_ros.photographs.solution import Solution


Colour = tuple[int, int, int]
_MOST_WCS_ERROR_PX = 0.5  # of a star
_FONT, _TEXT, _SMALLEST_TEXT = cv2.FONT_HERSHEY_SIMPLEX, (235, 235, 235), 0.5


@dataclass(frozen=True)
class Outputs:
    """Folders of annotated pictures and of FITS headers, None for no such files."""

    annotate_folder: Path | None = None
    wcs_folder: Path | None = None

    def check(self) -> None:
        """Make the folders; OutputError where that fails, before long work and not after it."""
        for folder in (self.annotate_folder, self.wcs_folder):
            if folder is not None:
                output_folder(folder)

    @property
    def writers(self) -> tuple[Callable[[str, Photograph, Solution, float], Path | None], ...]:
        """
        Return what writes the file of each kind, and returns its path, None for no such file.

        Each is called with a name without a suffix, an image, its solution and its Julian year.
        OutputError, and WcsError of image_wcs().
        """
        return self._write_picture, self._write_wcs

    def _write_picture(self, name: str, photograph: Photograph, solution: Solution, year: float
                       ) -> Path | None:
        if self.annotate_folder is None:
            return None
        picture = captioned(
            annotated(photograph.image, solution.centroids.uv, solution.identification.hip,
                      solution.sky, year, solution.bodies), caption(name, solution, year))
        # In memory: OpenCV reports a full disk on stderr alone.
        content = cv2.imencode('.png', picture[..., ::-1])[1].tobytes()
        return _written(self.annotate_folder / f'{name}.png', content)

    def _write_wcs(self, name: str, photograph: Photograph, solution: Solution, _: float
                   ) -> Path | None:
        if self.wcs_folder is None or solution.sky is None:
            return None
        stars_px = solution.centroids.uv[solution.identification.hip > 0]
        return _written(self.wcs_folder / f'{name}.wcs', image_wcs(
            solution.sky, photograph.mirrored, photograph.bottom_up, stars_px))


def _written(path: Path, content: bytes) -> Path:
    write_output(path, content)
    return path


def annotated(image: np.ndarray, uv: np.ndarray, hip: np.ndarray, sky: SkyMapping | None,
              year: float, bodies: tuple[BodyInImage, ...] = (), share: float = 1.0
              ) -> np.ndarray:
    """
    Return an image (H, W) as (H, W, 3) uint8 RGB with what is in it, and where north is.

    uv (N, 2) are its spots, hip (N,) their Hipparcos numbers, 0 for none; sky is None where the
    attitude is unknown. share is that of Labels.
    """
    labels = Labels(image.shape, uv, share)
    # Names come first, so that no number covers them.
    overlay = np.zeros((*image.shape, 3), np.uint8)
    if sky is not None:
        mark_scale(overlay, sky, labels)
        mark_figures(overlay, sky, year, labels)
        mark_bodies(overlay, bodies, labels)
        mark_named_stars(overlay, sky, year, hip, labels)
    return np.maximum(annotate(image, uv, hip, labels=labels), overlay)


def caption(name: str, solution: Solution, year: float) -> list[tuple[str, Colour]]:
    """Return what stands below a picture: what it shows, and what its marks mean."""
    field = '' if np.isnan(solution.fov_deg) else f'field {solution.fov_deg:.3f} deg, '
    found = (f'RA {solution.ra_deg:.4f} deg, Dec {solution.dec_deg:+.4f} deg, roll '
             f'{solution.roll_deg:.2f} deg, {field}{solution.matched} stars, '
             f'residual {solution.residual_arcsec:.2f} arcsec, ICRS, epoch J{year:.2f}'
             if solution.sky is not None else f'not solved: {solution.reason}')
    lines = [(f'{name}: {found}', _TEXT)]
    if solution.sky is not None:
        lines += [('green circle: identified star with its name or number in Hipparcos',
                   IDENTIFIED),
                  ('blue: constellations, bright stars that are not identified', NAMED)]
    if solution.bodies:
        lines.append(('yellow circle: planet, Moon or Sun', BODY))
    return [*lines, ('orange circle: detection that is not identified', FOUND)]


def captioned(picture: np.ndarray, lines: Sequence[tuple[str, Colour]]) -> np.ndarray:
    """Return a picture (H, W, 3) with lines of text below it, folded to its width."""
    width = picture.shape[1]
    scale = max(_SMALLEST_TEXT, width / 2000)
    thick = max(1, round(width / 1024))
    letter, height = cv2.getTextSize('0', _FONT, scale, thick)[0]
    folded = [(part, colour) for text, colour in lines
              for part in textwrap.wrap(text, max(10, int(0.97 * width / letter)))]
    strip = np.zeros((2 * height * len(folded) + height, width, 3), np.uint8)
    for number, (text, colour) in enumerate(folded, 1):
        cv2.putText(strip, text, (letter, 2 * height * number - height // 3), _FONT, scale,
                    colour, thick, cv2.LINE_AA)
    return np.vstack([picture, strip])


class WcsError(ValueError):
    """An image of which no FITS header says where its stars are."""


def image_wcs(sky: SkyMapping, mirrored: bool = False, bottom_up: bool = False,
              stars_px: np.ndarray = np.empty((0, 2))) -> bytes:
    """
    Return the FITS header of an image with columns and rows in the order of its file.

    WcsError where it has the pixels stars_px (N, 2) of the image elsewhere on the sky.
    """
    camera = sky.camera
    turned = np.array([mirrored, bottom_up])
    last = np.array([camera.width, camera.height]) - 1.0

    def other(pixels: np.ndarray) -> np.ndarray:
        """Return pixels of the file as those of the image, or the other way."""
        return np.where(turned, last - pixels, pixels)

    try:
        sip = fit_sip(lambda pixels: sky.directions(other(pixels)), camera.width, camera.height,
                      other(np.array([camera.cx, camera.cy])),
                      camera.distortion if camera.model.equidistant else None)
    except np.linalg.LinAlgError as error:
        raise WcsError(f'no FITS projection has its lens: {error}') from error
    header = wcs_header(sip, camera.width, camera.height)
    # As a reader has it, by the text alone.
    off_px = np.abs(sky.pixels(header_directions(header, other(stars_px))) - stars_px)
    if not (off_px < _MOST_WCS_ERROR_PX).all():
        raise WcsError(f'no FITS projection has its lens: the best one has stars '
                       f'{np.nanmax(off_px):.2g} px off, at most {_MOST_WCS_ERROR_PX:g} px are '
                       'written')
    return header
