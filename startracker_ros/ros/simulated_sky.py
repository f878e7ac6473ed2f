"""The instrument that the parameters of sky_simulator describe."""

from dataclasses import dataclass

from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.band import BandOptions
from startracker_ros.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.options import option, Options
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.source import SourceOptions
from startracker_ros.sky.artefacts import ArtefactOptions
from startracker_ros.sky.bright_bodies import BrightBodyOptions
from startracker_ros.sky.detector import DetectorOptions
from startracker_ros.sky.gyro import GyroOptions
from startracker_ros.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sky.motion_state import Motion
from startracker_ros.sky.mounted import HeadOptions, mounted, seed_in_namespace
from startracker_ros.sky.navigation import NavigationOptions
from startracker_ros.sky.presets import PRESETS, with_preset
from startracker_ros.sky.simulator import SkySimulator
from startracker_ros.sky.sources import SkyOptions
from startracker_ros.sky.target import TargetOptions


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
"""What a node needs for make_simulator() beside SourceOptions."""


def detector_options(node: PipelineNode) -> DetectorOptions:
    """Return the options of the detector, with the preset."""
    return with_preset(node.options(DetectorOptions), node.options(SceneOptions).preset)


def make_simulator(node: PipelineNode, camera: Camera, start_ns: int,
                   body: Motion | None = None) -> SkySimulator:
    """
    Return the simulator of a node from a stamp on, along the motion of a body or its own.

    Heads in different namespaces have seeds of their own.
    """
    options = node.options
    scene, head = options(SceneOptions), options(HeadOptions)
    seed = seed_in_namespace(scene.seed, node.get_namespace())
    motion = (motion_from_options(options(MotionOptions), seed=seed, head=head) if body is None
              else mounted(body, head))
    return SkySimulator(
        camera, motion,
        camera_catalog(camera, band=options(BandOptions)).brighter_than(scene.faint_limit),
        epoch_year_from_stamp(start_ns), sky_options=options(SkyOptions),
        body_options=options(BrightBodyOptions), detector_options=detector_options(node),
        artefact_options=with_preset(options(ArtefactOptions), scene.preset),
        gyro_options=options(GyroOptions), target_options=options(TargetOptions),
        navigation_options=options(NavigationOptions),
        frame_rate_hz=options(SourceOptions).frame_rate_hz, seed=seed)
