# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star images from files."""

from collections.abc import Sequence
import glob
import io
from pathlib import Path
import struct
from typing import NamedTuple
import zlib

import cv2
import numpy as np
from startracker_ros.core.camera.distortion import EQUIDISTANT, PLUMB_BOB
from startracker_ros.core.camera.levels import colour_levels, Levels, levels_of, rounds_noise
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.extras import extra, MissingLibraryError
from startracker_ros.io.images import fits_image, ser_video, xisf_image
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.io.images.exif import read_exif, Taken, upright

# More than any image of a star camera in any format.
_LARGEST_FILE_BYTES = 500_000_000
# The header of an image is in its first bytes, the end of a JPEG in its last ones.
_CHECKED_BYTES, _END_BYTES = 1 << 20, 1 << 16
# An image of so many needs some 2 GB while it is solved.
MOST_PIXELS = 120_000_000
# The catalogue has 25 stars a square degree, to V 11.
LEAST_FOV_DEG = 0.3
ANY_FISHEYE_DEG = 180.0
"""That of the camera that stands for a fisheye of which nothing is known."""

_GZIP = b'\x1f\x8b'
_RAW_SUFFIXES = ('.arw', '.cr2', '.cr3', '.dng', '.nef', '.orf', '.pef', '.raf', '.rw2', '.srw')
_SUFFIXES = ('.bmp', '.fit', '.fit.gz', '.fits', '.fits.fz', '.fits.gz', '.fts', '.jpeg', '.jpg',
             '.pgm', '.png', '.tif', '.tiff', '.webp', '.xisf', *_RAW_SUFFIXES)
# What it warns of is an ImageError. OpenCV 4.6, that of Ubuntu Noble, has the older name.
_SILENT = 0


(getattr(cv2, 'setLogLevel', None) or cv2.utils.logging.setLogLevel)(_SILENT)


class ImageError(ValueError):
    """A file that is not a star image; the text names it."""


class Photograph(NamedTuple):
    """
    An image (H, W) uint8 or uint16, and what its file says.

    fov_deg is the field of view of the long side, taken the time; None where unknown. bottom_up
    is whether the file has the lowest row of the image first, order_known whether it says which,
    mirrored whether its first column is the last one of the image. pointing_deg is where a mount
    says that it is, right ascension and declination. step is how much of the values of the file
    one level of the image is.
    """

    image: np.ndarray
    fov_deg: float | None = None
    taken: Taken | None = None
    bottom_up: bool = False
    order_known: bool = True
    mirrored: bool = False
    pointing_deg: tuple[float, float] | None = None
    step: float = 1.0

    @property
    def fov_x_deg(self) -> float | None:
        """The horizontal field of view, None where unknown or too small for the catalogue."""
        if self.fov_deg is None:
            return None
        half = np.tan(np.radians(self.fov_deg) / 2) * self.image.shape[1] / max(self.image.shape)
        fov_deg = float(np.degrees(2 * np.arctan(half)))
        return fov_deg if fov_deg >= LEAST_FOV_DEG else None

    def mirror(self) -> 'Photograph':
        """Return the photograph flipped from left to right."""
        return self._replace(image=np.ascontiguousarray(self.image[:, ::-1]),
                             mirrored=not self.mirrored)

    def turn_over(self) -> 'Photograph':
        """Return the photograph by the other order of the rows of its file."""
        return self._replace(image=np.ascontiguousarray(self.image[::-1]),
                             bottom_up=not self.bottom_up)


def read_image(path: str | Path) -> np.ndarray:
    """
    Return an image file as (H, W) uint8 or uint16, upright by its EXIF orientation.

    Colours are averaged to grey. FITS and camera RAW need the extras fits and raw.
    """
    return read_photograph(path).image


def read_photograph(path: str | Path) -> Photograph:
    """Return the image as read_image, and what EXIF or a FITS header has of it."""
    path = Path(path)
    try:
        with path.open('rb') as file:
            content = np.frombuffer(_decompressed(file.read(_LARGEST_FILE_BYTES + 1)), np.uint8)
    except OSError as error:
        raise ImageError(f'{path}: {error.strerror}') from error
    except zlib.error as error:
        raise ImageError(f'{path}: not whole: {error}') from error
    if len(content) > _LARGEST_FILE_BYTES:
        raise ImageError(f'{path}: more than {_LARGEST_FILE_BYTES // 1_000_000} MB')
    begin = content[:_CHECKED_BYTES].tobytes()
    try:
        if begin.startswith(fits_image.BEGIN):
            return Photograph(**fits_image.read_fits(content.tobytes(), MOST_PIXELS)._asdict())
        if begin.startswith(xisf_image.BEGIN):
            return Photograph(**xisf_image.read_xisf(content.tobytes(), MOST_PIXELS)._asdict())
        if begin.startswith(ser_video.BEGIN):
            return _first_of_ser(path)
        if path.suffix.lower() in _RAW_SUFFIXES:
            return _read_raw(content.tobytes())
    except (ValueError, MissingLibraryError) as error:
        raise ImageError(f'{path}: {error}') from error
    _check_content(path, begin, content[-_END_BYTES:].tobytes())
    return _decode(path, content)


def _decompressed(content: bytes) -> bytes:
    """Return the content of a file, out of gzip up to the size at which a file is too large."""
    if not content.startswith(_GZIP):
        return content
    # Its last four bytes are the length of the content, which some write wrong.
    return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(
        content[:-4], _LARGEST_FILE_BYTES + 1)


def _read_raw(content: bytes) -> Photograph:
    image = read_raw(content, MOST_PIXELS)
    # LibRaw has turned it upright.
    exif = read_exif(content, (2 * image.shape[1], 2 * image.shape[0]))
    return Photograph(image, exif.fov_deg, exif.taken)


def _decode(path: Path, content: np.ndarray) -> Photograph:
    """Return an image in a format of OpenCV; ImageError."""
    try:
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    except cv2.error as error:
        raise ImageError(f'{path}: OpenCV cannot read it: {error.err}') from error
    if image is None:
        raise ImageError(f'{path}: not an image that OpenCV can read')
    try:
        image, step = _grey_levels(image)
    except ValueError as error:
        raise ImageError(f'{path}: {error}') from error
    exif = read_exif(content.tobytes())
    return Photograph(upright(image, exif.orientation), exif.fov_deg, exif.taken, step=step)


def _first_of_ser(path: Path) -> Photograph:
    first = next(ser_video.ser_frames(path, MOST_PIXELS), None)
    if first is None:
        raise ValueError('a truncated SER file')
    return Photograph(grey(first.image), taken=first.taken)


def photograph_of(image: np.ndarray) -> Photograph:
    """
    Return an array (H, W), or (H, W, C) with 1, 3 or 4 channels, as a file of it would be read.

    Of any type of integers or floats: all but 8 and 16 bits are scaled. ValueError for another.
    """
    if not isinstance(image, np.ndarray) or image.dtype.kind not in 'uif':
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f'image is {kind}, must be an array of integers or floats, or a path')
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (1,), (3,), (4,)):
        raise ValueError(f'image has the shape {image.shape}, must be (H, W) or (H, W, 3)')
    if image.size > (1 if image.ndim == 2 else image.shape[2]) * MOST_PIXELS:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px, at most '
                         f'{MOST_PIXELS // 1_000_000} million px are solved')
    if not image.size:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px is empty')
    levels = _grey_levels(np.ascontiguousarray(image))
    return Photograph(levels.image, step=levels.step)


def _grey_levels(image: np.ndarray) -> Levels:
    """
    Return the levels (H, W) of an image (H, W) or (H, W, C).

    Of 8-bit colours it is their sum where the mean would round their noise away.
    """
    mean = grey(image)
    if (image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] > 1 and rounds_noise(mean)
            and not np.array_equal(image[..., 0], image[..., 1])):
        return Levels(colour_levels(image[..., :3]), 1 / 3)
    return levels_of(mean)


def grey(image: np.ndarray) -> np.ndarray:
    """Return (H, W) of (H, W) or (H, W, C): the mean of three channels."""
    if image.ndim == 2:
        return image
    if image.shape[2] == 1:
        return image[..., 0]
    # Less noisy than the weights of human vision. OpenCV has few types of pixels.
    if image.dtype in (np.uint8, np.uint16):
        return cv2.transform(image[..., :3], np.full((1, 3), 1 / 3))
    return image[..., :3].mean(axis=2)


def image_paths(paths: Sequence[Path]) -> list[Path]:
    """
    Return the paths, a folder replaced by the images in it, a pattern by what it matches.

    A pattern without a match remains, as a file that cannot be read.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += sorted(file for file in path.iterdir()
                            if file.name.lower().endswith(_SUFFIXES))
        elif not path.exists() and glob.has_magic(str(path)):
            found += [Path(match) for match in sorted(glob.glob(str(path), recursive=True))] or [
                path]
        else:
            found.append(path)
    return found


def _check_content(path: Path, begin: bytes, end: bytes) -> None:
    """Raise ImageError for images too large to decode and truncated JPEG."""
    if begin.startswith(b'\xff\xd8') and b'\xff\xd9' not in end:
        raise ImageError(f'{path}: a truncated JPEG')
    width, height = _size(begin)
    if width * height > MOST_PIXELS:
        raise ImageError(f'{path}: {width} x {height} px, at most '
                         f'{MOST_PIXELS // 1_000_000} million px are solved')


def _size(begin: bytes) -> tuple[int, int]:
    """Return width and height of a PNG, JPEG or TIFF by its first bytes; zeros if unknown."""
    if begin.startswith(b'\x89PNG') and len(begin) >= 24:
        width, height = struct.unpack('>II', begin[16:24])
        return width, height
    if begin.startswith(b'\xff\xd8'):
        return _jpeg_size(begin)
    if begin[:4] in (b'II*\0', b'MM\0*') and len(begin) >= 8:
        return _tiff_size(begin)
    return 0, 0


def _jpeg_size(begin: bytes) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(begin) and begin[at] == 0xff:
        marker, length = begin[at + 1], int.from_bytes(begin[at + 2:at + 4], 'big')
        # Start of frame, of any coding; the others in this range are tables.
        if 0xc0 <= marker <= 0xcf and marker not in (0xc4, 0xc8, 0xcc):
            height, width = struct.unpack('>HH', begin[at + 5:at + 9])
            return width, height
        at += 2 + length
    return 0, 0


def _tiff_size(begin: bytes) -> tuple[int, int]:
    order = '<' if begin.startswith(b'II') else '>'
    at, size = struct.unpack(f'{order}I', begin[4:8])[0], {256: 0, 257: 0}
    if at + 2 <= len(begin):
        count, = struct.unpack(f'{order}H', begin[at:at + 2])
        for entry in range(at + 2, min(at + 2 + 12 * count, len(begin) - 12), 12):
            tag, kind = struct.unpack(f'{order}HH', begin[entry:entry + 4])
            if tag in size:
                form, length = ('H', 2) if kind == 3 else ('I', 4)
                size[tag], = struct.unpack(f'{order}{form}', begin[entry + 8:entry + 8 + length])
    return size[256], size[257]


def calibrated_camera(camera_file: Path | None, fov_deg: float | None,
                      distortion_model: str = PLUMB_BOB) -> Camera | None:
    """
    Return the camera of a file; None if there is only fov_deg, which needs the image size.

    CameraError for an invalid file or field of view.
    """
    if camera_file is not None:
        return load_camera(camera_file)
    ideal_camera(1, 1, fov_deg, distortion_model)
    return None


def ideal_camera(width: int, height: int, fov_deg: float | None,
                 distortion_model: str = PLUMB_BOB) -> Camera:
    """Return the ideal camera of a field of view; CameraError for an impossible one."""
    if fov_deg is None:
        if distortion_model != EQUIDISTANT:
            raise CameraError('neither a camera file nor a field of view')
        fov_deg = ANY_FISHEYE_DEG
    if 0 < fov_deg < LEAST_FOV_DEG:
        raise CameraError(f'field of view {fov_deg:g} deg: in less than {LEAST_FOV_DEG:g} deg '
                          'the catalogue has too few stars')
    return Camera.from_fov(width, height, fov_deg, distortion_model)


def read_image_with_camera(path: Path, camera: Camera | None, fov_deg: float | None,
                           distortion_model: str) -> tuple[np.ndarray, Camera]:
    """Return an image and its camera, as camera_of(); ImageError."""
    image = read_image(path)
    return image, camera_of(path, image, camera, fov_deg, distortion_model)


def camera_of(path: Path | str, image: np.ndarray, camera: Camera | None, fov_deg: float | None,
              distortion_model: str = PLUMB_BOB) -> Camera:
    """
    Return the camera of an image (H, W): the given one, or an ideal one of fov_deg.

    A fisheye of which nothing is known has ANY_FISHEYE_DEG.

    ImageError when the given camera has another image size.
    """
    height, width = image.shape
    camera = camera or ideal_camera(width, height, fov_deg, distortion_model)
    if (camera.width, camera.height) != (width, height):
        raise ImageError(f'{path}: {width} x {height} px, the camera has '
                         f'{camera.width} x {camera.height}')
    return camera


def read_raw(content: bytes, most_pixels: int) -> np.ndarray:
    """
    Return a RAW image (H, W) uint16 upright, linear, at half the resolution of the sensor.

    Each pixel is the mean of the colours of one 2 x 2 cell of the mosaic. ValueError for a file
    that LibRaw cannot read or with more pixels; MissingLibraryError without rawpy.
    """
    with extra('raw', 'rawpy', 'A camera RAW file'):
        import rawpy
    try:
        with rawpy.imread(io.BytesIO(content)) as raw:
            width, height = raw.sizes.width, raw.sizes.height
            if width * height > most_pixels:
                raise ValueError(f'{width} x {height} px, at most '
                                 f'{most_pixels // 1_000_000} million px are solved')
            colours = raw.postprocess(
                half_size=True, gamma=(1, 1), no_auto_bright=True, output_bps=16,
                user_wb=[1.0, 1.0, 1.0, 1.0], output_color=rawpy.ColorSpace.raw)
    except rawpy.LibRawError as error:
        raise ValueError(f'LibRaw cannot read it: {error}') from error
    return colours.mean(axis=2).round().astype(np.uint16)
