# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star images as a person wants to see them: stretched, with marks and names."""

from typing import TYPE_CHECKING

import cv2
import numpy as np
from startracker_ros.core.catalog.deep import star_name
from startracker_ros.core.catalog.names import STAR_NAMES

if TYPE_CHECKING:
    from startracker_ros.core.stages.bodies import BodyInImage

# Two ticks, right of the star and below it, leave the star itself free.
RETICLE_TICKS_PX = np.array([(6.0, 0.0), (14.0, 0.0), (0.0, 6.0), (0.0, 14.0)])
_FONT, _LETTERS = cv2.FONT_HERSHEY_SIMPLEX, 0.5
_CIRCLE_PX = 9.0
FOUND = (255, 190, 60)
IDENTIFIED = (90, 230, 120)
BODY = (255, 235, 90)
_REJECTED = (230, 90, 90)


def stretch(image: np.ndarray) -> np.ndarray:
    """Return an (H, W) image as uint8: background dark, faint stars visible."""
    # A sample fixes the levels as well as the whole image does.
    sample = image[::7, ::7].astype(np.float32)
    low, high = np.percentile(sample, [25.0, 99.9])
    spread = max(float(high - low), 1.0)
    scaled = np.clip((image.astype(np.float32) - low) / spread, 0, None)
    return np.minimum(255, np.arcsinh(3 * scaled) * 60).astype(np.uint8)


def annotate(image: np.ndarray, uv: np.ndarray, hip: np.ndarray | None = None,
             rejected: np.ndarray | None = None, labels: 'Labels | None' = None) -> np.ndarray:
    """
    Return (H, W, 3) uint8 RGB of an image with a circle on each pixel uv (N, 2).

    Stars with a Hipparcos number in hip (N,) are drawn in green with their name or number, others
    in orange; a label that would cover a circle or another one of labels is left out. Small
    crosses in red are on spots rejected (M, 2).
    """
    picture = cv2.cvtColor(stretch(image), cv2.COLOR_GRAY2RGB)
    hip = np.zeros(len(uv), int) if hip is None else hip
    labels = labels or Labels(image.shape, uv)
    size = labels.size
    for u, v in np.empty((0, 2)) if rejected is None else rejected:
        cv2.drawMarker(picture, (round(float(u)), round(float(v))), _REJECTED,
                       cv2.MARKER_TILTED_CROSS, round(5 * size), labels.thick)
    for (u, v), number in zip(uv, hip):
        centre = (round(float(u)), round(float(v)))
        colour = IDENTIFIED if number else FOUND
        cv2.circle(picture, centre, round(_CIRCLE_PX * size), colour, labels.thick, cv2.LINE_AA)
        if number:
            name = STAR_NAMES.get(int(number)) or star_name(int(number))
            labels.write(picture, name, centre, colour)
    return picture


def mark_bodies(picture: np.ndarray, bodies: tuple['BodyInImage', ...], labels: 'Labels'
                ) -> None:
    """Draw a circle around each body, as large as its disc, and its name."""
    for body in bodies:
        radius = round(max(body.radius_px, 12 * labels.size))
        centre = (round(body.u), round(body.v))
        cv2.circle(picture, centre, radius, BODY, labels.thick, cv2.LINE_AA)
        labels.write(picture, body.name, centre, BODY, radius)


class Labels:
    """
    Texts of one picture, none of which covers another one or the circle of a pixel uv (N, 2).

    size is the scale of all marks, thick the width of their lines in px: pictures of any size look
    the same where they fill the width of a page, or a share of it.
    """

    def __init__(self, shape: tuple[int, ...], uv: np.ndarray, share: float = 1.0) -> None:
        self.size = max(1.0, max(shape) / 1024 / share)
        self.thick = round(self.size)
        self._shape = shape
        radius = _CIRCLE_PX * self.size
        self._taken = np.hstack([uv - radius, uv + radius])
        self._lines = np.empty((0, 2))

    def keep_off(self, points: np.ndarray) -> None:
        """Prefer places for texts that cover no points (M, 2) of a line."""
        self._lines = np.vstack([self._lines, points])

    def write(self, picture: np.ndarray, text: str, centre: tuple[int, int],
              colour: tuple[int, int, int], radius: int = 0) -> bool:
        """
        Write a label next to a mark, above or below it, unless it has no place there.

        Return whether it has.
        """
        (width, height), _ = cv2.getTextSize(text, _FONT, _LETTERS * self.size, self.thick)
        u, v = centre
        aside = max(round((_CIRCLE_PX + 3) * self.size), radius + round(4 * self.size))
        boxes = [np.array([left, top, left + width, top + height]) for left, top in (
            (u + aside, v - height // 2), (u - aside - width, v - height // 2),
            (u - width // 2, v - aside - height), (u - width // 2, v + aside))]
        free = [box for box in boxes if (box[:2] >= 0).all()
                and (box[2:] < self._shape[1::-1]).all() and not self._covered(box)]
        if free:
            box = min(free, key=self._on_lines)
            air = 3 * self.size
            self._taken = np.vstack([self._taken, box + [-air, -air, air, air]])
            cv2.putText(picture, text, (int(box[0]), int(box[3])), _FONT, _LETTERS * self.size,
                        colour, self.thick, cv2.LINE_AA)
        return bool(free)

    def corner(self, width: int, height: int, margin: int, *, right: bool) -> np.ndarray:
        """
        Return where the upper left end (2,) of a mark is, in the corner with the fewest marks.

        With right, those at the right come first, among as many marks.
        """
        far = np.array(self._shape[1::-1]) - margin - (width, height)
        places = [np.array([column, row]) for column in ((far[0], margin) if right
                                                         else (margin, far[0]))
                  for row in (far[1], margin)]
        boxes = [np.hstack([place, place + (width, height)]) for place in places]
        best = min(range(4), key=lambda number: self._covered(boxes[number]))
        self._taken = np.vstack([self._taken, boxes[best]])
        return places[best]

    def _covered(self, box: np.ndarray) -> int:
        """Return how many marks a box of left, top, right and bottom covers."""
        taken = self._taken
        return int(((taken[:, :2] < box[2:]) & (taken[:, 2:] > box[:2])).all(axis=1).sum())

    def _on_lines(self, box: np.ndarray) -> int:
        """Return how many points of lines are in a box."""
        return int(((self._lines >= box[:2]) & (self._lines <= box[2:])).all(axis=1).sum())
