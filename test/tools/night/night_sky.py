# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera on the Earth under the simulated sky."""

from collections.abc import Iterator

import numpy as np
from startracker_ros.core.astro.constants import YEAR_S
from startracker_ros.core.astro.earth import gcrs_from_itrf
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_matrix, quaternion_from_pointing,
    quaternion_from_rotation_vector)
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.night.sources import TimedImage

YEAR = 2026.5
START_NS = stamp_from_epoch_year(YEAR)
AIRLESS = Site(48.0, 11.0, 500.0, pressure_hpa=0.0)
CAMERA = Camera.from_fov(320, 320, 14.0)


class OnEarth:
    """Turns on the Earth at rate_rad_s (3,), on sensor axes, and shakes from frame to frame."""

    def __init__(self, rate_rad_s=(0.0, 0.0, 0.0), shake_rad=0.0, east_rad=0.3):
        self._rate = np.array(rate_rad_s, float)
        self._shake_rad = shake_rad
        self._start = quaternion_from_pointing(east_rad, 0.6, 0.2)

    def _steady(self, time_s):
        return multiply(quaternion_from_matrix(gcrs_from_itrf(YEAR + time_s / YEAR_S)), multiply(
            self._start, quaternion_from_rotation_vector(self._rate * time_s)))

    def at(self, time_s):
        year, half_s = YEAR + time_s / YEAR_S, 0.5
        shake = np.random.default_rng(round(1e3 * time_s)).normal(0, self._shake_rad, 3)
        rate = attitude_error(self._steady(time_s + half_s), self._steady(time_s - half_s))
        return MotionState(multiply(self._steady(time_s), quaternion_from_rotation_vector(shake)),
                           rate, AIRLESS.position_m(year), AIRLESS.velocity_m_s(year))


def images(motion=None, *, lens=CAMERA, frames=60, step_s=6.0, late_s=None,
           detector=DetectorOptions(), seed=0) -> Iterator[TimedImage]:
    """Yield images of a lens, each stamped late_s (F,) after its exposure."""
    simulator = SkySimulator(lens, motion or OnEarth(), camera_catalog(CAMERA), YEAR,
                             detector_options=detector, seed=seed)
    late_s = np.zeros(frames) if late_s is None else late_s
    for number, late in enumerate(late_s):
        time_s = number * step_s + 10.0
        yield TimedImage(START_NS + round((time_s + late) * 1e9), simulator.frame(time_s).image)


def arcsec_per_hour(*rates):
    return np.array(rates) * ARCSEC / 3600
