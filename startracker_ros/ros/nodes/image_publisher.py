# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""image_publisher: image files -> image_raw, camera_info."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from startracker_ros.core.options import option, Options
from startracker_ros.io.images.images import image_paths, ImageError, read_image
from startracker_ros.ros.diagnostics import ERROR, OK
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.image_topic import TransportOptions
from startracker_ros.ros.node import main_of, StartError
from startracker_ros.ros.source import CameraOptions, SourceNode, SourceOptions

_CACHE_BYTES = 256 * 2 ** 20


@dataclass(frozen=True)
class FileOptions(Options):
    """Which files are published."""

    path: str = option('', 'image file, or folder whose images are published in order of name',
                       read_only=True)
    loop: bool = option(False, 'begin again after the last image')

    def files(self) -> list[Path]:
        """Return the image files; StartError says what is wrong with path."""
        if not self.path:
            raise StartError('path is empty: give an image file or a folder')
        files = image_paths([Path(self.path)])
        if not files:
            raise StartError(f'path {self.path} holds no image')
        if not files[0].is_file():
            raise StartError(f'path {self.path} does not exist')
        return files


class ImagePublisherNode(SourceNode):
    """
    Publishes image files with the camera they were taken with.

    With loop, images are cached up to _CACHE_BYTES: reading a file takes longer than the whole
    pipeline.
    """

    option_classes = (SourceOptions, CameraOptions, FileOptions, FrameOptions, TransportOptions)
    task = 'images'

    def __init__(self) -> None:
        super().__init__('image_publisher')
        self._cached: dict[tuple[Path, int], np.ndarray] = {}

    def rebuild(self) -> None:
        self._files = self.options(FileOptions).files()
        # A bad first image or camera file stops the node here, where the user looks.
        try:
            self._use_camera_for(read_image(self._files[0]).shape)
        except ImageError as error:
            raise StartError(str(error)) from error
        self.start(self._camera, self._publish_file)

    def _use_camera_for(self, shape: tuple[int, int]) -> None:
        """Build the camera of images of one size."""
        self._shape = shape
        height, width = shape
        self._camera = self.options(CameraOptions).camera(width, height)

    def _publish_file(self, index: int, stamp_ns: int, time_s: float) -> None:
        if index >= len(self._files) and not self.options(FileOptions).loop:
            self.diagnostics.report(OK, 'all images published')
            return
        path = self._files[index % len(self._files)]
        try:
            image = self._read(path)
        except ImageError as error:
            self.diagnostics.counts['unreadable files'] += 1
            self.diagnostics.report(ERROR, str(error))
            return
        if image.shape != self._shape:
            self._use_camera_for(image.shape)
        self.publish_image(image, self._camera, self.sensor_header(stamp_ns))
        self.diagnostics.report(OK, 'publishing images')

    def _read(self, path: Path) -> np.ndarray:
        if not self.options(FileOptions).loop:
            return read_image(path)
        try:
            key = path, path.stat().st_mtime_ns
        except OSError as error:
            raise ImageError(f'{path}: {error.strerror}') from error
        if key not in self._cached:
            image = read_image(path)
            if image.nbytes + sum(one.nbytes for one in self._cached.values()) > _CACHE_BYTES:
                return image
            self._cached[key] = image
        return self._cached[key]


main = main_of(ImagePublisherNode)

if __name__ == '__main__':
    main()
