# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The instrument of a data sheet: the lens, what the tracker knows of it, and the detector."""

from dataclasses import dataclass, replace
from pathlib import Path

from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.yaml_text import read_yaml
from startracker_ros.sim.sky.detector import DetectorOptions

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
        raise OpticsError(f'{path}: {", ".join(unknown)} is no option of the detector; there '
                          f'are {", ".join(sorted(known))}')
    try:
        return replace(DETECTOR, **values)
    except ValueError as error:
        raise OpticsError(f'{path}: {error}') from error


def _degrees(angle_rad: float) -> str:
    return f'{angle_rad * 57.29577951308232:.2f}'
