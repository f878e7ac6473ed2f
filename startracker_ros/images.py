"""Star images out of files."""

from pathlib import Path

import cv2
import numpy as np


class ImageError(ValueError):
    """A file that holds no star image; the text names it."""


def read_image(path: str | Path) -> np.ndarray:
    """Return an image file as (H, W) uint8 or uint16; colours are averaged to grey."""
    path = Path(path)
    try:
        content = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise ImageError(f'{path}: {error.strerror}') from error
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    if image is None:
        raise ImageError(f'{path}: not an image that OpenCV can read')
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f'{path}: pixels of type {image.dtype}, must be 8 or 16 bit integers')
    if image.ndim == 3:
        # Every channel sees the star: their mean is less noisy than a weighting for the eye.
        image = image[..., :3].mean(axis=2).round().astype(image.dtype)
    return image
