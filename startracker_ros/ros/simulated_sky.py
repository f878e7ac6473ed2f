# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The instrument that the parameters of sky_simulator describe."""

from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.camera.model import Camera
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.source import SourceOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import SceneOptions, simulator_parts
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.motion_state import Motion
from startracker_ros.sim.sky.mounted import HeadOptions, mounted, seed_in_namespace
from startracker_ros.sim.sky.presets import with_preset
from startracker_ros.sim.sky.simulator import SkySimulator


def detector_options(node: PipelineNode) -> DetectorOptions:
    """Return the options of the detector, with the preset."""
    return with_preset(node.options(DetectorOptions), node.options(SceneOptions).preset)


def make_simulator(node: PipelineNode, camera: Camera, start_ns: int,
                   body: Motion | None = None) -> SkySimulator:
    """
    Return the simulator of a node from a stamp on, along the motion of a body or its own.

    Heads in different namespaces have seeds of their own.
    """
    head = node.options(HeadOptions)
    seed = seed_in_namespace(node.options(SceneOptions).seed, node.get_namespace())
    motion = (motion_from_options(node.options(MotionOptions), seed=seed, head=head)
              if body is None else mounted(body, head))
    return SkySimulator(camera, motion, epoch_year=epoch_year_from_stamp(start_ns),
                        frame_rate_hz=node.options(SourceOptions).frame_rate_hz, seed=seed,
                        **simulator_parts(node.options, camera))
