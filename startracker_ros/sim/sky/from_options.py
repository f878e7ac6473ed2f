# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated instrument out of the options of sky_simulator."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.bright_bodies import BrightBodyOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import MotionOptions
from startracker_ros.sim.sky.mounted import HeadOptions
from startracker_ros.sim.sky.sensors import GyroOptions, NavigationOptions
from startracker_ros.sim.sky.sources import SkyOptions
from startracker_ros.sim.sky.target import TargetOptions

# --- presets: values for many options at once ---

_Kind = TypeVar('_Kind', bound=Options)

PRESETS: dict[str, dict[str, object]] = {
    'none': {},
    # A bad day in low orbit: worn sensor, bright limb near the field, solar protons.
    'harsh': {
        'motion_smear': True, 'line_time_us': 10.0, 'psf_corner_sigma_px': 1.2,
        'coma_corner_px': 2.0, 'astigmatism_corner_px': 0.5, 'vignetting_percent': 25.0,
        'dark_current_e_s': 100.0, 'hot_pixel_fraction': 5e-4, 'flat_field_percent': 1.0,
        'row_noise_dn': 0.7, 'column_pattern_dn': 0.7, 'blooming': True,
        'stray_light_e': 500.0, 'cosmic_ray_hits_cm2_s': 1000.0, 'trails': 1,
        'star_like_spots': 5, 'ghost_ratio': 0.003, 'saturated_columns': 1, 'warm_columns': 4,
        'dead_columns': 2, 'dead_rows': 1, 'torn_frame_probability': 0.01,
        'repeated_frame_probability': 0.01},
}


def with_preset(options: _Kind, preset: str) -> _Kind:
    """Return options with the values of a preset in place of those that are at their default."""
    values = PRESETS[preset]
    return replace(options, **{
        row.name: values[row.name] for row in options.table()
        if row.name in values and getattr(options, row.name) == row.default})


# --- the instrument ---

class OptionsOf(Protocol):
    """Returns the options of a class."""

    def __call__(self, cls: type[_Kind], /) -> _Kind:
        """Return the options of a class."""


@dataclass(frozen=True)
class SceneOptions(Options):
    """Which sky is simulated, and how many pixels see it."""

    width: int = option(1024, 'image width; a camera_file brings its own', unit='px',
                        low=16, high=4096)
    height: int = option(1024, 'image height; a camera_file brings its own', unit='px',
                         low=16, high=4096)
    faint_limit: float = option(
        9.0, 'faintest star that is drawn, V; beyond 9 only fields below 4 deg have stars',
        unit='mag', low=0.0, high=DEEP_LIMIT)
    seed: int = option(1, 'seed of all noise: the same seed in the same namespace gives the same '
                       'images', low=0, high=2 ** 31 - 1)
    preset: str = option(
        'none', 'harsh: a bad day of a worn sensor; its values replace those of the parameters '
        'that are at their defaults', choices=tuple(PRESETS))


SKY_OPTIONS: tuple[type[Options], ...] = (
    MotionOptions, HeadOptions, SkyOptions, BrightBodyOptions, TargetOptions, DetectorOptions,
    ArtefactOptions, GyroOptions, NavigationOptions, SceneOptions, BandOptions)
"""What a node needs for simulator_parts()."""


def simulator_parts(options: OptionsOf, camera: Camera) -> dict[str, Any]:
    """Return the arguments of SkySimulator other than camera, motion, time and seed."""
    scene = options(SceneOptions)
    return {
        'catalog': camera_catalog(camera, band=options(BandOptions)).brighter_than(
            scene.faint_limit),
        'sky_options': options(SkyOptions), 'body_options': options(BrightBodyOptions),
        'detector_options': with_preset(options(DetectorOptions), scene.preset),
        'artefact_options': with_preset(options(ArtefactOptions), scene.preset),
        'gyro_options': options(GyroOptions), 'target_options': options(TargetOptions),
        'navigation_options': options(NavigationOptions)}
