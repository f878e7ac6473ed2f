# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated instrument out of the options of sky_simulator."""

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.bright_bodies import BrightBodyOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.gyro import GyroOptions
from startracker_ros.sim.sky.motion import MotionOptions
from startracker_ros.sim.sky.mounted import HeadOptions
from startracker_ros.sim.sky.navigation import NavigationOptions
from startracker_ros.sim.sky.presets import PRESETS, with_preset
from startracker_ros.sim.sky.sources import SkyOptions
from startracker_ros.sim.sky.target import TargetOptions

_Kind = TypeVar('_Kind', bound=Options)


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
