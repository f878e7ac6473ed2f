# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The instrument of a data sheet: lens, what the tracker knows of it, detector; its motions."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.core.yaml_text import read_yaml
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion_state import MotionState

EPOCH_YEAR = 2026.5
START_NS = stamp_from_epoch_year(EPOCH_YEAR)
FRAME_RATE_HZ = 10.0
ORBIT = CircularOrbit(EARTH_RADIUS_M + 700e3, 0.5, 0.0, 0.0)
DEFAULT_CAMERA = Camera.from_fov(1024, 1024, 12.0)

DETECTOR = DetectorOptions(
    motion_smear=True, flat_field_percent=1.0, hot_pixel_fraction=1e-5, dark_current_e_s=50.0)
"""The sensor of the simulator with smear and with the unevenness of its pixels: without PRNU,
dark current and hot pixels there would be no pixel spatial error."""


class OpticsError(ValueError):
    """A file of optics that cannot be used; the text names the file and the value."""


@dataclass(frozen=True)
class Instrument:
    """The lens that takes the images, the camera that the star tracker uses, and the detector."""

    lens: Camera
    camera: Camera
    detector: DetectorOptions = DETECTOR

    @property
    def conditions(self) -> dict[str, str]:
        """Return what the figures depend on, in words."""
        lens, detector = self.lens, self.detector
        return {
            'camera': f'{lens.width} x {lens.height} px, focal length {lens.fx:.1f} px, '
                      f'{_degrees(lens.fov_x_rad)} x {_degrees(lens.fov_y_rad)} deg',
            'detector': f'PSF sigma {detector.psf_sigma_px:g} px, exposure '
                        f'{detector.exposure_s:g} s, {detector.zero_flux_e_s:.3g} e-/s at V 0, '
                        f'background {detector.background_e:g} e-, read noise '
                        f'{detector.read_noise_e:g} e-, full well {detector.full_well_e:g} e-, '
                        f'dark {detector.dark_current_e_s:g} e-/s, PRNU '
                        f'{detector.flat_field_percent:g} %, hot pixels '
                        f'{detector.hot_pixel_fraction:g}'}


def load_optics(path: Path) -> DetectorOptions:
    """
    Return the detector of a YAML file: options of the detector of sky_simulator by name.

    The layout of ROS parameter files, sky_simulator: ros__parameters:, is accepted too. What
    the file leaves out is that of DETECTOR. OpticsError names what is wrong.
    """
    try:
        values = read_yaml(path)
    except OSError as error:
        raise OpticsError(f'{path}: {error.strerror}') from error
    except ValueError as error:
        raise OpticsError(f'{path}: {error}') from error
    for key in ('sky_simulator', 'ros__parameters'):
        if isinstance(values, dict) and list(values) == [key]:
            values = values[key]
    if not isinstance(values, dict):
        raise OpticsError(f'{path}: no options of the detector by name')
    known = {row.name for row in DetectorOptions.table()}
    unknown = [str(name) for name in values if name not in known]
    if unknown:
        raise OpticsError(f'{path}: {", ".join(unknown)} is not an option of the detector; there '
                          f'are {", ".join(sorted(known))}')
    try:
        return replace(DETECTOR, **values)
    except ValueError as error:
        raise OpticsError(f'{path}: {error}') from error


def _degrees(angle_rad: float) -> str:
    return f'{angle_rad * 57.29577951308232:.2f}'


# --- motions of a Monte Carlo: many pointings in turn, and turns that get faster ---

RUN_S = 100.0
"""Time between the beginnings of two runs of Spins."""


@dataclass(frozen=True)
class Pointings:
    """
    Independent pointings, number k around second k.

    quaternion (N, 4) is q_icrf_from_sensor at that second, rate_rad_s (N, 3) the constant rate
    on sensor axes around it: one simulator renders all of them.
    """

    quaternion: np.ndarray
    rate_rad_s: np.ndarray

    def at(self, time_s: float) -> MotionState:
        """Return the state."""
        index = int(np.rint(time_s))
        rate_rad_s = self.rate_rad_s[index]
        turn = quaternion_from_rotation_vector(rate_rad_s * (time_s - index))
        return MotionState(multiply(self.quaternion[index], turn), rate_rad_s, *ORBIT.at(time_s))


@dataclass(frozen=True)
class Spins:
    """
    Turns about fixed axes, number k from second k RUN_S on.

    Each of q_start (N, 4) turns about its axis (N, 3) on sensor axes at rate_rad_s, which grows
    by acceleration_rad_s2 from start_s after its beginning.
    """

    q_start: np.ndarray
    axis: np.ndarray
    rate_rad_s: float
    acceleration_rad_s2: float
    start_s: float

    def at(self, time_s: float) -> MotionState:
        """Return the state; half of the time of a run belongs to what is before its beginning."""
        run = int(np.rint(time_s / RUN_S))
        within_s = time_s - run * RUN_S
        since_s = max(within_s - self.start_s, 0.0)
        angle_rad = self.rate_rad_s * within_s + self.acceleration_rad_s2 * since_s ** 2 / 2
        rate_rad_s = self.rate_rad_s + self.acceleration_rad_s2 * since_s
        turn = quaternion_from_rotation_vector(angle_rad * self.axis[run])
        return MotionState(multiply(self.q_start[run], turn), rate_rad_s * self.axis[run],
                           *ORBIT.at(time_s))


def across_boresight(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random axes (count, 3) across the boresight: the stars move over the image."""
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], -1)
