# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A device that is read in a thread, and opened again when it is lost."""

from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Event, Thread
import time
from typing import NamedTuple

import cv2
from startracker_ros.core.exposure.control import Setting
from startracker_ros.io.images.capture import (
    Captured, CaptureError, CaptureOptions, Device, open_device)
from startracker_ros.io.images.images import ImageError

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
