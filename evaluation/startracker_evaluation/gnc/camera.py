# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What sees the sky in the loop: the pipeline behind images or star lists."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.sampled_motion import SampledMotion
from startracker_ros.sim.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(1024, 1024, 12.0)
EPOCH_YEAR = 2026.5
START_NS = stamp_from_epoch_year(EPOCH_YEAR)
SIGMA_PX = 0.1
MAGNITUDE_LIMIT = 6.5
SUN_LIGHT_E = 60000.0
"""Light in each pixel while the Sun blinds the camera: four times the full well."""

SUN_FALLOFF_DEG = 1000.0
"""The same light all over the image."""


@dataclass(frozen=True)
class FrameFault:
    """What is wrong with a frame; it is exposed offset_s after its time tag."""

    blinded: bool = False
    dropped: bool = False
    torn: bool = False
    offset_s: float = 0.0


SOUND = FrameFault()


@dataclass(frozen=True)
class Observation:
    """
    What the star tracker reports of a frame.

    quaternion (4,) is q_icrf_from_sensor, None without a trusted attitude, then as covariance
    (3, 3) rad^2 and rate_rad_s (3,) about sensor axes; the rate is None while it is unknown.
    state is that of the tracker.
    """

    state: str
    quaternion: np.ndarray | None = None
    covariance: np.ndarray | None = None
    rate_rad_s: np.ndarray | None = None


class LoopCamera(Protocol):
    """A star tracker on a motion whose newest sample is the frame."""

    def observe(self, time_ns: int, motion: SampledMotion, fault: FrameFault) -> Observation:
        """Return the report of a frame, time_ns after the start."""


def observation_of(frame: FrameResult) -> Observation:
    """Return what a controller learns of a frame of the pipeline."""
    attitude = frame.attitude
    if attitude is None:
        return Observation(str(frame.state))
    return Observation(str(frame.state), attitude.quaternion, attitude.covariance_sensor,
                       None if frame.tracked is None else frame.tracked.rate_rad_s)


class StarListCamera:
    """Centroids of catalogue stars with noise of SIGMA_PX, of an observer at rest."""

    def __init__(self, *, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._sky = onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR, MAGNITUDE_LIMIT)
        self._before: Centroids | None = None
        self._pipeline = StarTracker.with_options(CAMERA, EPOCH_YEAR, StarTrackerOptions(
            identification=IdentificationOptions(magnitude_limit=MAGNITUDE_LIMIT),
            tracker=TrackerOptions(magnitude_limit=MAGNITUDE_LIMIT),
            aberration=AberrationOptions(aberration='none')))

    def observe(self, time_ns: int, motion: SampledMotion, fault: FrameFault) -> Observation:
        """Return the report of a frame."""
        q = motion.at(time_ns * 1e-9 + fault.offset_s).q_icrf_from_sensor
        seen, _ = star_list(self._sky, CAMERA, q, SIGMA_PX, self._rng, false=3,
                            missing=1.0 if fault.blinded else 0.05, brightest_false=2.0)
        before, self._before = self._before, seen
        if fault.torn and before is not None:
            row = self._rng.uniform(0, CAMERA.height)
            seen = seen.select(seen.uv[:, 1] < row).joined(
                before.select(before.uv[:, 1] >= row))
        return observation_of(self._pipeline.process_centroids(START_NS + time_ns, seen))


class ImageCamera:
    """Rendered images, smeared by the motion, of an observer in orbit."""

    def __init__(self, *, seed: int, frame_rate_hz: float) -> None:
        self._seed, self._frame_rate_hz = seed, frame_rate_hz
        self._pipeline = StarTracker(CAMERA, EPOCH_YEAR)
        self._simulators: dict[tuple[bool, bool], SkySimulator] = {}

    def observe(self, time_ns: int, motion: SampledMotion, fault: FrameFault) -> Observation:
        """Return the report of a frame."""
        key = fault.blinded, fault.torn
        if key not in self._simulators:
            self._simulators[key] = self._simulator(motion, *key)
        stamp_ns = START_NS + time_ns
        self._pipeline.motion.add_state(stamp_ns, motion.at(time_ns * 1e-9).geocentric)
        image = self._simulators[key].frame(round(time_ns * 1e-9 + fault.offset_s, 9)).image
        return observation_of(self._pipeline.process(stamp_ns, image))

    def _simulator(self, motion: SampledMotion, blinded: bool, torn: bool) -> SkySimulator:
        return SkySimulator(
            CAMERA, motion, load_catalog(), EPOCH_YEAR,
            detector_options=DetectorOptions(
                motion_smear=True, stray_light_e=SUN_LIGHT_E * blinded,
                stray_light_falloff_deg=SUN_FALLOFF_DEG),
            artefact_options=ArtefactOptions(torn_frame_probability=float(torn)),
            frame_rate_hz=self._frame_rate_hz, seed=self._seed)
