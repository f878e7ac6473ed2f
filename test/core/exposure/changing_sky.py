# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera whose exposure and gain can be set, under skies that change; and its star tracker."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.exposure.control import (
    ControlState, ExposureLimits, next_setting, Setting)
from startracker_ros.core.exposure.image_figures import ImageFigures
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import Frame, SkySimulator
from startracker_ros.tools.figures.correctness import error_over_bound

CAMERA = Camera.from_fov(384, 384, 14.0)
LIMITS = ExposureLimits(Setting(0.1, 1.0), Setting(800.0, 16.0))
FIRST = Setting(100.0, 1.0)
PERIOD_S = 1.0
LATENCY = 2
"""Images that are exposed already when a setting is made."""
START_NS = stamp_from_epoch_year(2026.5)


class Sky(NamedTuple):
    """
    What is between the camera and the stars, which move at rate_deg_s.

    light_e_s are electrons per pixel and second, at one edge where falloff_deg is small.
    """

    light_e_s: float = 30.0
    transparency: float = 1.0
    falloff_deg: float = 1000.0
    psf_sigma_px: float = 0.8
    rate_deg_s: float = 0.02


@cache
def catalog() -> StarCatalog:
    return load_catalog()


def photograph(sky: Sky, setting: Setting, number: int) -> Frame:
    """Return the frame of a camera of 12 bit."""
    exposure_s = setting.exposure_ms / 1e3
    light_e = sky.light_e_s * exposure_s
    detector = DetectorOptions(
        exposure_s=exposure_s, psf_sigma_px=sky.psf_sigma_px, motion_smear=True,
        zero_flux_e_s=2e6 * sky.transparency, background_e=0.0, full_well_e=20000.0,
        stray_light_e=min(light_e, 1e5), stray_light_falloff_deg=sky.falloff_deg,
        gain_e_per_dn=4.0 / setting.gain)
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=200.0, dec_deg=25.0,
        rate_deg_s=(sky.rate_deg_s, 0.0, 0.0)))
    return SkySimulator(CAMERA, motion, catalog(), 2026.5, detector_options=detector,
                        frame_rate_hz=1 / PERIOD_S, seed=number).frame((1 + number) * PERIOD_S)


class Watch:
    """A star tracker, and whether it had a right attitude at each frame."""

    def __init__(self) -> None:
        self._tracker = StarTracker(CAMERA, 2026.5)
        self.locked: list[bool] = []
        self.wrong = 0

    def see(self, number: int, frame: Frame) -> None:
        stamp_ns = START_NS + round(number * PERIOD_S * 1e9)
        self._tracker.motion.add_state(stamp_ns, frame.state.geocentric)
        attitude = self._tracker.process(stamp_ns, frame.image).attitude
        good = attitude is not None and error_over_bound(
            attitude.quaternion, attitude.covariance_sensor, frame.state.q_icrf_from_sensor) < 1
        self.wrong += attitude is not None and not good
        self.locked.append(good)


def fixed(skies: Callable[[int], Sky], frames: int, setting: Setting) -> Watch:
    """Return what a star tracker has with one setting."""
    watch = Watch()
    for number in range(frames):
        watch.see(number, photograph(skies(number), setting, number))
    return watch


def automatic(skies: Callable[[int], Sky], frames: int, *, first: Setting = FIRST,
              limits: ExposureLimits = LIMITS) -> tuple[Watch, list[Setting]]:
    """Return what it has with the settings of the control, and these."""
    watch, extractor, state = Watch(), CentroidExtractor(), ControlState(first)
    made = [first] * (LATENCY + 1)
    for number in range(frames):
        # A setting takes effect some images after it was made.
        setting = made[number]
        frame = photograph(skies(number), setting, number)
        watch.see(number, frame)
        chosen = made[-1]
        if setting == chosen:
            figures = ImageFigures.of(frame.image, extractor.measure(frame.image))
            state, chosen = next_setting(state, setting, figures, limits)
        made.append(chosen)
    return watch, made[:frames]
