# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Pictures of every effect of the simulator: python test/simulator_pictures.py [FOLDER].

Each picture shows the same part of the sky without and with the effect: side by side, or
overlaid with red for without and cyan for with. FOLDER is docs/pictures by default.
"""

from dataclasses import dataclass, field
from pathlib import Path
import sys
from typing import Any

import cv2
import numpy as np
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import PRESETS
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

_EPOCH_YEAR = 2026.5
_CAMERA = Camera.from_fov(1024, 1024, 12.0)
_SIDE_PX, _SEPARATOR_PX, TITLE_PX = 340, 6, 30
_GREY = (200, 200, 200)
# Fewer grey levels make smaller files.
_GREYS = 52

Options = dict[str, Any]


@dataclass(frozen=True)
class Picture:
    """
    One effect: options shared by both halves, and the options of the effect.

    Options are those of MotionOptions, SkyOptions, DetectorOptions and ArtefactOptions. corner
    (u, v) and size_px select the part of the image; white_e is the white level in electrons above
    the background; overlay replaces side by side; frames > 1 shows the maximum of each pixel over
    that number of frames at 10 Hz, from time_s on.
    """

    effect: Options
    shared: Options = field(default_factory=dict)
    corner: tuple[int, int] = (430, 430)
    size_px: int = 170
    camera: Camera = _CAMERA
    effect_camera: Camera | None = None
    white_e: float = 200.0
    overlay: bool = False
    frames: int = 1
    time_s: float = 0.0


# For effects on positions: noise would only make the files large.
_QUIET = {'noise': False}
# For those on the whole image, which is shown at a third of its size.
_LARGE_STARS = {'psf_sigma_px': 2.5, 'zero_flux_e_s': 1e7, **_QUIET}
# An even grey.
_EVEN = {'stray_light_e': 200.0, 'stray_light_falloff_deg': 1000.0, **_LARGE_STARS}


def _planet(name: str) -> Options:
    ra_deg, dec_deg = np.degrees(radec_from_unit(bodies_from_earth(_EPOCH_YEAR).direction[
        BODIES.index(name)]))
    return {'ra_deg': float(ra_deg), 'dec_deg': float(dec_deg)}


def _lens(name: str, value: float) -> Picture:
    """Return the picture of an effect that grows towards the corners."""
    return Picture({name: value}, {'zero_flux_e_s': 2e7, **_QUIET}, corner=(103, 38), size_px=113,
                   white_e=300.0)


def _whole(effect: Options, white_e: float = 200.0) -> Picture:
    """Return the picture of an effect on the whole image."""
    return Picture(effect, _LARGE_STARS, corner=(0, 0), size_px=1024, white_e=white_e)


_ROTATING = {'motion': 'constant_rate', 'rate_deg_s': (0.3, 0.4, 3.0)}
_SHAKEN = {'motion': 'inertial', 'motion_smear': True}
_WIDE = Camera.from_fov(1024, 1024, 24.0)
_NARROW = Camera.from_fov(1024, 1024, 1.5)

PICTURES = {
    'psf_over_field': Picture({'psf_corner_sigma_px': 2.5}, corner=(80, 880), size_px=85),
    'motion_smear': Picture({'motion_smear': True}, _ROTATING, corner=(560, 480), size_px=85),
    'rolling_shutter': Picture(
        {'line_time_us': 100.0}, {'motion': 'constant_rate', 'rate_deg_s': (0.0, 5.0, 0.0),
                                  **_LARGE_STARS},
        corner=(0, 0), size_px=1024, overlay=True),
    'roll_jitter': Picture({'jitter_deg_s': 0.5}, {'motion': 'inertial', **_QUIET},
                           corner=(684, 0), size_px=340, frames=60),
    'vibration': Picture({'vibration_arcsec': 150.0}, _SHAKEN, corner=(560, 480), size_px=85),
    'kick': Picture({'kick_arcsec': 250.0}, _SHAKEN, corner=(560, 480), size_px=85, time_s=0.4),
    'dark_current': Picture({'dark_current_e_s': 500.0}),
    'hot_pixels': Picture({'hot_pixel_fraction': 0.003}),
    'flat_field': Picture({'flat_field_percent': 5.0}, {'background_e': 4000.0}, white_e=1000.0),
    'bit_depth': Picture({'bit_depth': 8, 'bias_dn': 4.0, 'gain_e_per_dn': 64.0}),
    'full_well': Picture({'full_well_e': 1500.0}, {'psf_sigma_px': 1.2}, corner=(470, 580),
                         size_px=68, white_e=4000.0),
    'cosmic_rays': Picture({'cosmic_ray_hits_cm2_s': 20000.0, 'pixel_pitch_um': 3.0}),
    'stray_light': _whole({'stray_light_e': 1500.0, 'stray_light_angle_deg': -60.0}, 2000.0),
    'planets': Picture({'planets': True}, _planet('Jupiter')),
    'satellites': Picture({'satellites': 8, 'satellite_rate_deg_s': 3.0},
                          {'motion': 'inertial', 'motion_smear': True, **_QUIET},
                          corner=(342, 342), size_px=340),
    'aberration': Picture({'aberration': True}, {'ra_deg': 56.75, 'dec_deg': 24.12,
                                                 'psf_sigma_px': 3.0, **_QUIET},
                          camera=_NARROW, corner=(400, 330), size_px=340, white_e=50.0,
                          overlay=True),
    'distortion': Picture({}, _LARGE_STARS, camera=_WIDE,
                          effect_camera=Camera(1024, 1024, _WIDE.fx, _WIDE.fy, 511.5, 511.5,
                                               (-0.4, 0.0, 0.0, 0.0, 0.0)),
                          corner=(0, 0), size_px=1024, overlay=True),
    'coma': _lens('coma_corner_px', 15.0),
    'astigmatism': _lens('astigmatism_corner_px', 2.0),
    'vignetting': Picture({'vignetting_percent': 60.0}, _EVEN, corner=(0, 0), size_px=1024,
                          white_e=600.0),
    'ghosts': Picture({'ghost_ratio': 0.02}, {'zero_flux_e_s': 2e7, **_QUIET},
                      corner=(342, 342), size_px=340, white_e=500.0),
    'double_exposure': Picture({'double_exposure_share': 0.3}, {'zero_flux_e_s': 2e7},
                               white_e=1000.0),
    'readout_direction': Picture(
        {'readout_direction': 'up'},
        {'motion': 'constant_rate', 'rate_deg_s': (0.0, 5.0, 0.0), 'line_time_us': 100.0,
         **_LARGE_STARS},
        corner=(0, 0), size_px=1024, overlay=True),
    'trails': _whole({'trails': 3}),
    'star_like_spots': Picture({'star_like_spots': 100}, corner=(342, 342), size_px=340),
    'debris': Picture({'debris': 150}, corner=(342, 342), size_px=340),
    'moon': _whole({'moon_e': 40000.0, 'moon_distance_deg': 2.0, 'blooming': True}),
    'earth_limb': _whole({'earth_e': 3000.0, 'earth_angle_deg': 70.0}, 500.0),
    'proton_storm': Picture({'cosmic_ray_hits_cm2_s': 3e5}),
    'blooming': Picture({'blooming': True}, {'full_well_e': 1500.0, 'psf_sigma_px': 1.2},
                        corner=(470, 580), size_px=68, white_e=2000.0),
    'saturated_lines': _whole({'saturated_columns': 2, 'saturated_rows': 1}),
    'defective_lines': Picture({'warm_columns': 5, 'dead_columns': 3, 'dead_rows': 2}, _EVEN,
                               corner=(0, 0), size_px=1024, white_e=1000.0),
    'row_noise': Picture({'row_noise_dn': 3.0}, size_px=113),
    'column_pattern': Picture({'column_pattern_dn': 3.0}, size_px=113),
    'torn_frame': Picture({'torn_frame_probability': 0.5},
                          {'motion': 'constant_rate', 'rate_deg_s': (0.0, 2.0, 0.0),
                           **_LARGE_STARS},
                          corner=(0, 0), size_px=1024, overlay=True, time_s=0.8),
    'harsh': Picture(PRESETS['harsh'], {'zero_flux_e_s': 1e7}, corner=(0, 0), size_px=1024,
                     white_e=1500.0),
}


def _options_of(cls: Any, values: Options) -> Any:
    return cls(**{row.name: values[row.name] for row in cls.table() if row.name in values})


def _render(picture: Picture, values: Options, camera: Camera) -> np.ndarray:
    # The same stars in every picture.
    values = {'aberration': False} | values
    simulator = SkySimulator(
        camera, motion_from_options(_options_of(MotionOptions, values), seed=1), load_catalog(),
        _EPOCH_YEAR, sky_options=_options_of(SkyOptions, values),
        detector_options=_options_of(DetectorOptions, values),
        artefact_options=_options_of(ArtefactOptions, values), seed=1)
    image = np.max([simulator.frame(picture.time_s + k / 10).image
                    for k in range(picture.frames)], 0)
    u, v = picture.corner
    part = image[v:v + picture.size_px, u:u + picture.size_px].astype(np.float32)
    options = _options_of(DetectorOptions, values)
    electrons = (part - options.bias_dn) * options.gain_e_per_dn
    shape = (_SIDE_PX, _SIDE_PX)
    if picture.size_px <= _SIDE_PX:
        return cv2.resize(electrons, shape, interpolation=cv2.INTER_NEAREST)
    return cv2.resize(electrons, shape, interpolation=cv2.INTER_AREA)


def draw(picture: Picture) -> np.ndarray:
    """Return the picture (H, W, 3) uint8 BGR, with a title of each half above it."""
    without = _render(picture, picture.shared, picture.camera)
    with_it = _render(picture, picture.shared | picture.effect,
                      picture.effect_camera or picture.camera)
    # The same stretch for both halves.
    black_e = _options_of(DetectorOptions, picture.shared).background_e
    grey = [np.arcsinh(5 * np.clip((image - black_e) / picture.white_e, 0, 1)) / np.arcsinh(5)
            for image in (without, with_it)]
    left, right = (np.uint8(np.rint(g * (_GREYS - 1)) * (255 // (_GREYS - 1)))
                   for g in grey)
    if picture.overlay:
        return np.vstack([_titles(_SIDE_PX, (('without', 0, (0, 0, 255)),
                                             ('with', _SIDE_PX // 2, (255, 255, 0)))),
                          np.stack([right, right, left], -1)])
    separator = np.full((_SIDE_PX, _SEPARATOR_PX), 128, np.uint8)
    both = cv2.cvtColor(np.hstack([left, separator, right]), cv2.COLOR_GRAY2BGR)
    return np.vstack([_titles(both.shape[1], (
        ('without', 0, _GREY), ('with', _SIDE_PX + _SEPARATOR_PX, _GREY))), both])


def _titles(width: int, titles: tuple[tuple[str, int, tuple[int, int, int]], ...]) -> np.ndarray:
    """Return a strip (H, width, 3) with titles: text, column, colour."""
    strip = np.zeros((TITLE_PX, width, 3), np.uint8)
    for text, column, colour in titles:
        cv2.putText(strip, text, (column + 8, TITLE_PX - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.7,
                    colour, 1, cv2.LINE_AA)
    return strip


def main(folder: Path = Path('docs/pictures')) -> None:
    """Write one PNG for each effect."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in PICTURES.items():
        image = draw(picture)
        if not picture.overlay:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        cv2.imwrite(str(folder / f'{name}.png'), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:2]))
