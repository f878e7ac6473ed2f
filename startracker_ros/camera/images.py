"""Star images from files."""

from pathlib import Path

import cv2
import numpy as np
from startracker_ros.camera.files import load_camera
from startracker_ros.camera.model import Camera, CameraError

# More than any image of a star camera in any format.
_LARGEST_FILE_BYTES = 500_000_000


class ImageError(ValueError):
    """A file that is not a star image; the text names it."""


def read_image(path: str | Path) -> np.ndarray:
    """Return an image file as (H, W) uint8 or uint16; colours are averaged to grey."""
    path = Path(path)
    try:
        with path.open('rb') as file:
            content = np.frombuffer(file.read(_LARGEST_FILE_BYTES + 1), np.uint8)
    except OSError as error:
        raise ImageError(f'{path}: {error.strerror}') from error
    if len(content) > _LARGEST_FILE_BYTES:
        raise ImageError(f'{path}: more than {_LARGEST_FILE_BYTES // 1_000_000} MB')
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    if image is None:
        raise ImageError(f'{path}: not an image that OpenCV can read')
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f'{path}: pixels of type {image.dtype}, must be 8 or 16 bit integers')
    if image.ndim == 3:
        # The mean of the channels is less noisy than the weights of human vision.
        image = image[..., :3].mean(axis=2).round().astype(image.dtype)
    return image


def calibrated_camera(camera_file: Path | None, fov_deg: float | None) -> Camera | None:
    """
    Return the camera of a file; None if there is only fov_deg, which needs the image size.

    CameraError for an invalid file or field of view.
    """
    if camera_file is not None:
        return load_camera(camera_file)
    _ideal_camera(1, 1, fov_deg)
    return None


def _ideal_camera(width: int, height: int, fov_deg: float | None) -> Camera:
    if fov_deg is None:
        raise CameraError('neither a camera file nor a field of view')
    return Camera.from_fov(width, height, fov_deg)


def read_image_with_camera(path: Path, camera: Camera | None, fov_deg: float | None
                           ) -> tuple[np.ndarray, Camera]:
    """
    Return an image and its camera: the given one, or an ideal one of fov_deg.

    ImageError also when the given camera has another image size.
    """
    image = read_image(path)
    height, width = image.shape
    camera = camera or _ideal_camera(width, height, fov_deg)
    if (camera.width, camera.height) != (width, height):
        raise ImageError(f'{path}: {width} x {height} px, the camera has '
                         f'{camera.width} x {camera.height}')
    return image, camera
