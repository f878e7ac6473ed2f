# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Images of a live camera, or of files in its place, stamped with the middle of each exposure.

Cameras are those of Video4Linux, opened by OpenCV. Its units: exposures of 0.1 ms, automatic
exposure off is 1 (V4L2_EXPOSURE_MANUAL), the gain is that of the driver.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from glob import glob
from itertools import count
import os
from pathlib import Path
from threading import Event, Thread
import time
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from startracker_ros.core.camera.levels import mosaic_levels
from startracker_ros.core.exposure.control import Setting
from startracker_ros.core.options import option, Options
from startracker_ros.io.images.images import grey, image_paths, ImageError, read_image
from startracker_ros.io.images.video import frames, is_video

_CONVERTED = ('auto', 'MJPG', 'YUYV')
_GREY = {'GREY': 1, 'Y10': 2, 'Y12': 2, 'Y16': 2}
_MOSAICS = {'BA81': 1, 'GBRG': 1, 'GRBG': 1, 'RGGB': 1, 'BG10': 2, 'GB10': 2, 'BA10': 2,
            'RG10': 2, 'BG12': 2, 'GB12': 2, 'BA12': 2, 'RG12': 2, 'BYR2': 2, 'GB16': 2,
            'GR16': 2, 'RG16': 2}
_PIXEL_BYTES = {**_GREY, **_MOSAICS}
_MANUAL = 1.0
_EXPOSURES_PER_S = 1e4
# Images that are exposed already, or wait in the driver, when a setting is made.
_UNCHANGED = 3
# A buffer that waited for longer was not stamped by the monotonic clock.
_OLDEST_S = 5.0
_IMAGES_HZ = 10.0


@dataclass(frozen=True)
class CaptureOptions(Options):
    """The device and its settings."""

    device: str = option(
        '/dev/video0', 'camera of Video4Linux (/dev/video0, /dev/v4l/by-id/...); in its place a '
        'video, or a folder or pattern of images')
    frame_rate_hz: float = option(
        0.0, 'frames a second; 0: as the camera or the video has them, 10 for images',
        unit='Hz', low=0.0, high=1000.0)
    exposure_ms: float = option(0.0, 'exposure time, 0 leaves the setting of the camera, mostly '
                                'automatic', unit='ms', low=0.0, high=600_000.0)
    gain: float = option(-1.0, 'gain in units of the driver, -1 leaves the setting of the camera',
                         low=-1.0, high=1e6)
    width: int = option(0, 'image width of the camera, 0 for 640', unit='px', low=0, high=20_000)
    height: int = option(0, 'image height of the camera, 0 for 480', unit='px', low=0, high=20_000)
    pixel_format: str = option(
        'auto', 'V4L2 format (FOURCC) of the camera; auto, MJPG and YUYV become 8 bit grey; GREY '
        'and Y10 to Y16 are published as they are, Bayer mosaics at half the resolution, each '
        '2 x 2 cell as its sum (8 bit) or mean, in 16 bit', choices=(*_CONVERTED, *_PIXEL_BYTES))


class CaptureError(RuntimeError):
    """A device that gives no images; the text names it and says what to do."""


class Captured(NamedTuple):
    """
    An image (H, W) uint8 or uint16, UNIX time of the middle of its exposure in ns, its source.

    The time, that of the middle row, is off by stamp_error_s at most. setting is that of the
    image, None where it is not known, as in the images after a change.
    """

    image: np.ndarray
    stamp_ns: int
    stamp_from: str
    stamp_error_s: float
    setting: Setting | None = None


class Device(Protocol):
    """An open camera, or files in its place; ends says whether that is not a loss."""

    name: str
    ends: bool
    problems: list[str]
    period_s: float

    def change(self, setting: Setting) -> None:
        """Set exposure time and gain, for some image after the next one."""

    def read(self) -> Captured | None:
        """Return the next image when it is there, None when there is none any more."""

    def close(self) -> None:
        """Release the device."""


def open_device(options: CaptureOptions, wait: Callable[[float], object] = time.sleep) -> Device:
    """Return an open device; wait sleeps until the time of the next image. CaptureError."""
    device = options.device
    if device.isdecimal() or device.startswith('/dev/'):
        return V4l2Camera(options)
    if not glob(device, recursive=True):
        raise CaptureError(f'device {device}: no such file')
    return FileDevice(options, wait)


class V4l2Camera:
    """A camera of Video4Linux."""

    ends = False

    def __init__(self, options: CaptureOptions,
                 open_capture: Callable[[int, int], Any] = cv2.VideoCapture) -> None:
        number = _video_number(options.device)
        self.name = f'/dev/video{number}'
        self.problems: list[str] = []
        self._pixel_bytes = _PIXEL_BYTES.get(options.pixel_format)
        self._mosaic = options.pixel_format in _MOSAICS
        self._capture = open_capture(number, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise CaptureError(f'device {self.name}: {_why_closed(self.name)}')
        self._set(options)
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        self.period_s = 1 / rate_hz if rate_hz > 0 else 1 / 30
        self._setting: Setting | None = None
        self._unchanged = 0
        # An automatic exposure is anything up to the period.
        self._exposure_s, self._exposure_error_s = self.period_s / 2, self.period_s / 2
        if options.exposure_ms:
            self._know(options.exposure_ms)

    def _know(self, exposure_ms: float) -> None:
        """Take the exposure time that the camera has; that asked for where it does not say."""
        exposure = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        self._exposure_s = exposure / _EXPOSURES_PER_S if exposure > 0 else exposure_ms / 1e3
        self._exposure_error_s = 0.0
        self._setting = Setting(1e3 * self._exposure_s, self._capture.get(cv2.CAP_PROP_GAIN))

    def change(self, setting: Setting) -> None:
        """
        Set exposure time, and gain where it differs, below 0 never.

        The images that are exposed already have the old ones.
        """
        before_s, before = self._exposure_s, self._setting
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, setting.exposure_ms * _EXPOSURES_PER_S / 1e3)
        if setting.gain >= 0 and (before is None or setting.gain != before.gain):
            self._capture.set(cv2.CAP_PROP_GAIN, setting.gain)
        fixed = 'exposure_ms cannot be set'
        if self._capture.get(cv2.CAP_PROP_EXPOSURE) < 0 and fixed not in self.problems:
            self.problems.append(fixed)
        self._know(setting.exposure_ms)
        # Until then it is one of both.
        self._exposure_error_s = abs(self._exposure_s - before_s)
        self._unchanged = _UNCHANGED

    def _set(self, options: CaptureOptions) -> None:
        """Set what is asked for; what the camera ignores is a problem."""
        wanted: dict[str, tuple[int, float]] = {}
        if options.pixel_format != 'auto':
            wanted['pixel_format'] = cv2.CAP_PROP_FOURCC, _fourcc(options.pixel_format)
        if options.width and options.height:
            wanted['width'] = cv2.CAP_PROP_FRAME_WIDTH, options.width
            wanted['height'] = cv2.CAP_PROP_FRAME_HEIGHT, options.height
        elif options.width or options.height:
            self.problems.append('width and height are set together only')
        if options.frame_rate_hz:
            wanted['frame_rate_hz'] = cv2.CAP_PROP_FPS, options.frame_rate_hz
        # A change of format or size resets the conversion.
        if self._pixel_bytes is not None:
            wanted['raw pixels'] = cv2.CAP_PROP_CONVERT_RGB, 0
        if options.exposure_ms:
            wanted['manual exposure'] = cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL
            wanted['exposure_ms'] = (cv2.CAP_PROP_EXPOSURE,
                                     options.exposure_ms * _EXPOSURES_PER_S / 1e3)
        if options.gain >= 0:
            wanted['gain'] = cv2.CAP_PROP_GAIN, options.gain
        for key, value in wanted.values():
            self._capture.set(key, value)
        self.problems += [problem for name, (key, value) in wanted.items()
                          if (problem := _ignored(name, value, self._capture.get(key)))]

    def read(self) -> Captured | None:
        """Return the next image, None when the camera is lost."""
        if not self._capture.grab():
            return None
        # Before the image is decoded.
        arrived_ns, arrived_s = time.time_ns(), time.monotonic()
        age_s = arrived_s - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        good, pixels = self._capture.retrieve()
        if not good or pixels is None:
            return None
        # Drivers stamp the beginning or the end of the exposure, of the first row: a rolling
        # shutter has the middle row up to half a period later.
        source, late_s = 'driver', self.period_s / 2
        if not 0 <= age_s < _OLDEST_S:
            # An image arrives when its transfer ends, up to a period after its exposure.
            source, late_s, age_s = 'arrival', self.period_s, 0.0
        setting = None if self._unchanged else self._setting
        if self._unchanged:
            self._unchanged -= 1
        elif setting is not None:
            self._exposure_error_s = 0.0
        error_s = self._exposure_error_s / 2 + self._exposure_s / 2 + late_s
        stamp_ns = arrived_ns - round((age_s + self._exposure_s / 2) * 1e9)
        return Captured(self._image(pixels), stamp_ns, source, error_s, setting)

    def _image(self, pixels: np.ndarray) -> np.ndarray:
        """Return the image (H, W) of what OpenCV returns."""
        if self._pixel_bytes is None:
            return grey(pixels)
        height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        # Rows may be padded. V4L2 formats of two bytes are little-endian.
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        image = np.ascontiguousarray(rows[:, :width * self._pixel_bytes]).view(
            '<u2' if self._pixel_bytes == 2 else np.uint8)
        if not self._mosaic:
            return image
        return mosaic_levels(image)

    def close(self) -> None:
        """Release the camera."""
        self._capture.release()


class FileDevice:
    """Files in place of a camera: a video or images, at their pace from now on."""

    ends = True

    def __init__(self, options: CaptureOptions, wait: Callable[[float], object]) -> None:
        self.name = options.device
        self.problems: list[str] = []
        self._wait = wait
        self._times_images = _times_and_images(Path(options.device), options.frame_rate_hz)
        self._begin_s = 0.0
        self._begin_ns: int | None = None
        self.period_s = 1 / (options.frame_rate_hz or _IMAGES_HZ)

    def change(self, setting: Setting) -> None:
        """Name what files cannot do."""
        fixed = 'exposure: auto is for cameras, files stay as they are'
        if fixed not in self.problems:
            self.problems.append(fixed)

    def read(self) -> Captured | None:
        """Return the next image when it is due, None after the last one; ImageError."""
        following = next(self._times_images, None)
        if following is None:
            return None
        time_s, image = following
        if self._begin_ns is None:
            self._begin_s, self._begin_ns = time.monotonic() - time_s, time.time_ns()
        self._wait(max(0.0, self._begin_s + time_s - time.monotonic()))
        return Captured(image, self._begin_ns + round(time_s * 1e9), 'file', 0.0)

    def close(self) -> None:
        """Close the files."""
        self._times_images = iter(())


def _times_and_images(path: Path, rate_hz: float) -> Iterator[tuple[float, np.ndarray]]:
    """Yield time in s and image of the frames of a video, or of image files in order of name."""
    if is_video(path):
        last_s = -1.0
        for frame in frames(path):
            if rate_hz or frame.time_s <= last_s:
                rate_hz = rate_hz or _IMAGES_HZ
                last_s = frame.number / rate_hz
            else:
                last_s = frame.time_s
            yield last_s, frame.image
        return
    for number, file in zip(count(), image_paths([path])):
        yield number / (rate_hz or _IMAGES_HZ), read_image(file)


def _video_number(device: str) -> int:
    """Return N of /dev/videoN, which a device of another name may be a link to."""
    if device.isdecimal():
        return int(device)
    number = os.path.realpath(device).removeprefix('/dev/video')
    if not number.isdecimal():
        raise CaptureError(f'device {device}: no camera of Video4Linux; {_present()}')
    return int(number)


def _why_closed(name: str) -> str:
    if not os.path.exists(name):
        return f'no such camera; {_present()}'
    if not os.access(name, os.R_OK | os.W_OK):
        return 'no permission: add the user to the group video'
    return 'it cannot be opened: another program uses it, or it is not a node for images'


def _present() -> str:
    found = sorted(glob('/dev/video*'))
    return f'there are {", ".join(found)}' if found else 'there is none'


def _fourcc(name: str) -> int:
    return cv2.VideoWriter.fourcc(*name.ljust(4))


def _ignored(name: str, wanted: float, has: float) -> str:
    """Return how a setting differs from what was asked for, empty when it does not."""
    if name == 'pixel_format':
        if int(has) == int(wanted):
            return ''
        text = int(has).to_bytes(4, 'little', signed=True).decode('ascii', 'replace').strip('\0 ')
        return f'pixel_format is {text}'
    # Drivers have steps: of the exposure some per cent.
    if abs(has - wanted) <= max(0.5, 0.05 * abs(wanted)):
        return ''
    if has < 0:
        return f'{name} cannot be set'
    scale = _EXPOSURES_PER_S / 1e3 if name == 'exposure_ms' else 1.0
    return f'{name} is {has / scale:g}, not {wanted / scale:g}'


# --- a camera in a thread of its own ---

_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0
_SILENT_S, _SILENT_PERIODS = 3.0, 4.0

OPENING, CAPTURING, LOST = 'opening', 'capturing', 'lost'
ENDED, FAILED = 'ended', 'failed'


class State(NamedTuple):
    """OPENING, CAPTURING, LOST or, for good, ENDED or FAILED, and a text."""

    name: str
    text: str


class CaptureThread:
    """
    Reads a device in a thread from start() to stop().

    on_image is called in that thread when newest() has an image. An image that was not fetched
    before the next one is dropped and counted. A device that cannot be opened, or is lost, is
    opened again after 0.5 s, then 1 s, up to 10 s.
    """

    def __init__(self, options: CaptureOptions, on_image: Callable[[], None],
                 open_it: Callable[[CaptureOptions, Callable], Device] = open_device) -> None:
        self._on_image = on_image
        self._stop = Event()
        self._open = partial(open_it, options, self._stop.wait)
        self._newest: deque[Captured] = deque(maxlen=1)
        self._image_s, self._period_s = time.monotonic(), 0.0
        self._state = State(OPENING, f'opening device {options.device}')
        self._thread = Thread(target=self._run, name='capture', daemon=True)
        self.dropped = self.losses = 0
        self.problems: list[str] = []
        self.period_s = 0.0
        self._setting: Setting | None = None

    def change(self, setting: Setting) -> None:
        """Set exposure time and gain of the device before its next image."""
        self._setting = setting

    def start(self) -> None:
        """Open the device and begin."""
        self._thread.start()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Release the device, which may take longer where the driver does not respond."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    @property
    def running(self) -> bool:
        """Whether the thread is running."""
        return self._thread.is_alive()

    @property
    def state(self) -> State:
        """The state; a driver that sends nothing counts as a lost device."""
        silent_s = time.monotonic() - self._image_s
        if self._state.name == CAPTURING and (
                silent_s > max(_SILENT_S, _SILENT_PERIODS * self._period_s)):
            return State(LOST, f'{self._state.text}: no image for {silent_s:.0f} s')
        return self._state

    def newest(self) -> Captured | None:
        """Return the newest image once, None until the next one."""
        try:
            return self._newest.popleft()
        except IndexError:
            return None

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        while not self._stop.is_set():
            try:
                device = self._open()
            except CaptureError as error:
                self._state = State(LOST, str(error))
            else:
                if self._read(device):
                    return
                gave = self._state.name == CAPTURING
                if gave:
                    self.losses += 1
                    wait_s = _FIRST_WAIT_S
                self._state = State(LOST, f'device {device.name} gives no {"more " * gave}images: '
                                    'it is opened again')
            self._stop.wait(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _read(self, device: Device) -> bool:
        """Read until the device is lost, return False, or until that is the end."""
        self.problems, self.period_s = device.problems, device.period_s
        try:
            while not self._stop.is_set():
                setting, self._setting = self._setting, None
                if setting is not None:
                    device.change(setting)
                captured = device.read()
                if captured is None:
                    ended = device.ends and self._state.name == CAPTURING
                    if ended:
                        self._state = State(ENDED, f'all images of {device.name} are published')
                    return ended
                now_s = time.monotonic()
                self._period_s, self._image_s = now_s - self._image_s, now_s
                self._state = State(CAPTURING, f'device {device.name}')
                self.dropped += len(self._newest)
                self._newest.append(captured)
                self._on_image()
        except cv2.error:
            return False
        except ImageError as error:
            self._state = State(FAILED, str(error))
        finally:
            device.close()
        return True
