"""Star images as a person wants to see them: stretched, with marks and names."""

import cv2
import numpy as np

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
             rejected: np.ndarray | None = None) -> np.ndarray:
    """
    Return (H, W, 3) uint8 RGB of an image with a circle on each pixel uv (N, 2).

    Stars with a Hipparcos number in hip (N,) are drawn in green with it, others in orange; small
    crosses in red are on spots rejected (M, 2).
    """
    picture = cv2.cvtColor(stretch(image), cv2.COLOR_GRAY2RGB)
    hip = np.zeros(len(uv), int) if hip is None else hip
    size = max(1.0, max(image.shape) / 1024)
    for u, v in np.empty((0, 2)) if rejected is None else rejected:
        cv2.drawMarker(picture, (round(float(u)), round(float(v))), _REJECTED,
                       cv2.MARKER_TILTED_CROSS, round(5 * size))
    for (u, v), number in zip(uv, hip):
        centre = (round(float(u)), round(float(v)))
        colour = _IDENTIFIED if number else _FOUND
        cv2.circle(picture, centre, round(9 * size), colour, 1, cv2.LINE_AA)
        if number:
            cv2.putText(picture, str(number), (centre[0] + round(12 * size), centre[1]),
                        cv2.FONT_HERSHEY_SIMPLEX, 0.35 * size, colour, 1, cv2.LINE_AA)
    return picture
