# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated star tracker camera, with options by keyword."""

from datetime import datetime
from typing import Any, TypeVar

from startracker_ros.core.astro.epoch import julian_year
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.options import Options, options_by_class
from startracker_ros.sim.sky import simulator
from startracker_ros.sim.sky.from_options import SceneOptions, simulator_parts, SKY_OPTIONS
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.mounted import HeadOptions

_Kind = TypeVar('_Kind', bound=Options)


class SkySimulator(simulator.SkySimulator):
    """
    Images, gyro rates and truth of a camera under the sky of the catalogue.

    Args:
        camera: Lens of the images.
        epoch_year: Epoch of time 0: Julian year, datetime or text as `'2026-07-02T12:00:00Z'`,
            UTC without a zone.
        frame_rate_hz: Rate of the frames, which torn and repeated ones depend on, Hz.
        **options: Parameters of the node sky_simulator, as `rate_deg_s=(0.1, 0.0, 0.0)`.

    Raises:
        ValueError: A wrong argument or option; the text names those there are.

    """

    def __init__(self, camera: Camera, epoch_year: float | datetime | str, *,
                 frame_rate_hz: float = 10.0, **options: Any) -> None:
        chosen = options_by_class(SKY_OPTIONS, options)

        def of(cls: type[_Kind]) -> _Kind:
            found = chosen[cls]
            assert isinstance(found, cls)
            return found
        motion, seed = of(MotionOptions), of(SceneOptions).seed
        if motion.motion == 'topic':
            raise ValueError("motion = 'topic' needs the node: take another one")
        super().__init__(camera, motion_from_options(motion, seed=seed, head=of(HeadOptions)),
                         epoch_year=julian_year(epoch_year, 'epoch_year'),
                         frame_rate_hz=frame_rate_hz, seed=seed,
                         **simulator_parts(of, camera))
