"""Star images as a person wants to see them: stretched, with marks and names."""

import cv2
import numpy as np
from startracker_ros.core.catalog.names import BRIGHT_STARS

# Two ticks, right of the star and below it, leave the star itself free.
RETICLE_TICKS_PX = np.array([(6.0, 0.0), (14.0, 0.0), (0.0, 6.0), (0.0, 14.0)])
_FOUND = (255, 190, 60)
_IDENTIFIED = (90, 230, 120)
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
    in orange; a label that would cover another one of labels is left out. Small crosses in red are
    on spots rejected (M, 2).
    """
    picture = cv2.cvtColor(stretch(image), cv2.COLOR_GRAY2RGB)
    hip = np.zeros(len(uv), int) if hip is None else hip
    labels = labels or Labels(image.shape)
    size = labels.size
    for u, v in np.empty((0, 2)) if rejected is None else rejected:
        cv2.drawMarker(picture, (round(float(u)), round(float(v))), _REJECTED,
                       cv2.MARKER_TILTED_CROSS, round(5 * size))
    for (u, v), number in zip(uv, hip):
        centre = (round(float(u)), round(float(v)))
        colour = _IDENTIFIED if number else _FOUND
        cv2.circle(picture, centre, round(9 * size), colour, 1, cv2.LINE_AA)
        if number:
            labels.write(picture, BRIGHT_STARS.get(int(number), str(number)), centre, colour)
    return picture


class Labels:
    """Texts of one picture, none of which covers another; size is the scale of the marks."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.size = max(1.0, max(shape) / 1024)
        self._taken: list[tuple[int, int, int, int]] = []

    def write(self, picture: np.ndarray, text: str, centre: tuple[int, int],
              colour: tuple[int, int, int], radius: int = 0) -> None:
        """Write a label beside a mark, unless it would leave the picture or cover one."""
        size, aside = self.size, max(round(12 * self.size), radius + round(4 * self.size))
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.35 * size, 1)
        for left in (centre[0] + aside, centre[0] - aside - width):
            box = (left, centre[1] - height, left + width, centre[1])
            if (left >= 0 and box[2] < picture.shape[1] and box[1] >= 0
                    and not any(box[0] < other[2] and other[0] < box[2] and box[1] < other[3]
                                and other[1] < box[3] for other in self._taken)):
                self._taken.append(box)
                cv2.putText(picture, text, (left, centre[1]), cv2.FONT_HERSHEY_SIMPLEX,
                            0.35 * size, colour, 1, cv2.LINE_AA)
                return
