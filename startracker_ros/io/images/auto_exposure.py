# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exposure time and gain of a camera by the stars in its images, in a separate thread."""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.exposure.control import (
    ControlState, ExposureLimits, ExposureOptions, next_setting, Setting)
from startracker_ros.core.exposure.image_figures import ImageFigures
from startracker_ros.io.images.capture import Captured

_FIRST_MS = 100.0
_UNKNOWN = 10  # images without a known setting: the device does not have it, or is a new one


class Settable(Protocol):
    """A camera whose exposure time and gain can be changed, for some image after the next one."""

    @property
    def period_s(self) -> float:
        """Period of the images."""

    def change(self, setting: Setting) -> None:
        """Set exposure time and gain; called from another thread."""


class AutoExposure:
    """
    Chooses the settings of a camera by its images, one at a time.

    Images are searched as fast as one thread can; those meanwhile are not used. figures and
    setting are those of the last one, None before.
    """

    def __init__(self, options: ExposureOptions, capture: Settable, first_ms: float) -> None:
        """Begin with an exposure time of first_ms, 0 for 100 ms, and the gain there is."""
        self._options, self._capture = options, capture
        self._first_ms = first_ms or _FIRST_MS
        self._extractor = CentroidExtractor()
        self._state: ControlState | None = None
        self._thread = ThreadPoolExecutor(1, 'exposure')
        self._work: Future[None] | None = None
        self._unknown = _UNKNOWN
        self.figures: ImageFigures | None = None
        self.setting: Setting | None = None

    def offer(self, captured: Captured) -> None:
        """Use an image, unless its setting is not known or another one is being searched."""
        if captured.setting is None:
            self._unknown += 1
            if self._unknown > _UNKNOWN:
                self._unknown = 0
                self._capture.change(self.setting or Setting(
                    min(self._first_ms, 1e3 * self._capture.period_s), self._options.gain_min))
            return
        self._unknown = 0
        if self._work is None or self._work.done():
            if self._work is not None:
                self._work.result()
            self._work = self._thread.submit(self._use, captured, captured.setting)

    def _use(self, captured: Captured, setting: Setting) -> None:
        figures = ImageFigures.of(captured.image, self._extractor.measure(captured.image))
        limits = ExposureLimits.of(self._options, 1e3 * self._capture.period_s, setting.gain)
        state = self._state or ControlState(setting)
        self._state, chosen = next_setting(state, setting, figures, limits)
        self.figures, self.setting = figures, setting
        if chosen != setting:
            self._capture.change(chosen)

    def values(self) -> dict[str, object]:
        """Return diagnostics of the last image that was searched, empty before."""
        figures = self.figures
        return {} if figures is None else {
            'stars': len(figures.flux), 'background_dn': f'{figures.background_dn:.1f}',
            'fwhm_px': f'{figures.fwhm_px:.2f}'}

    def close(self) -> None:
        """End the thread, after the image in work."""
        self._thread.shutdown(wait=True, cancel_futures=True)
