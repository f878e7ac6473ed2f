# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A picture of an image with what is in it, and lines of text below."""

from collections.abc import Sequence
import textwrap

import cv2
import numpy as np
from startracker_ros.core.stages.annotate import annotate, Labels, mark_bodies
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.deep_sky import DeepSkyObject
from startracker_ros.photographs.sky_marks import (
    mark_deep_sky, mark_figures, mark_magnitudes, mark_named_stars, mark_scale)
from startracker_ros.photographs.uncatalogued import Uncatalogued


Colour = tuple[int, int, int]
TEXT: Colour = (235, 235, 235)
_FONT, _SMALLEST_TEXT = cv2.FONT_HERSHEY_SIMPLEX, 0.5


def annotated(image: np.ndarray, uv: np.ndarray, hip: np.ndarray, sky: SkyMapping | None,
              year: float, bodies: tuple[BodyInImage, ...] = (), share: float = 1.0,
              deep_sky: Sequence[DeepSkyObject] = (), unknown: Sequence[Uncatalogued] = ()
              ) -> np.ndarray:
    """
    Return an image (H, W) as (H, W, 3) uint8 RGB with what is in it, and where north is.

    uv (N, 2) are its spots, hip (N,) their Hipparcos numbers, 0 for none; sky is None where the
    attitude is unknown. share is that of Labels. Of the spots unknown the magnitude is written.
    """
    labels = Labels(image.shape, uv, share)
    # Names come first, so that no number covers them.
    overlay = np.zeros((*image.shape, 3), np.uint8)
    if sky is not None:
        mark_scale(overlay, sky, labels)
        mark_figures(overlay, sky, year, labels)
        mark_bodies(overlay, bodies, labels)
        mark_magnitudes(overlay, unknown, labels)
        mark_deep_sky(overlay, sky, deep_sky, labels)
        mark_named_stars(overlay, sky, year, hip, labels)
    return np.maximum(annotate(image, uv, hip, labels=labels), overlay)


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
