# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of a simulated camera through the star tracker: what it publishes, tallied."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.maths.rotation import ARCSEC, random_attitude
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import SteadyMotion
from startracker_ros.sim.sky.motion_state import Motion
from startracker_ros.sim.sky.shake import ShakenMotion, SwayingMotion
from startracker_ros.sim.sky.simulator import Frame, SkySimulator
from startracker_ros.tools.datasheet.instrument import Instrument
from startracker_ros.tools.datasheet.tally import (
    CAMERA, EPOCH_YEAR, START_NS, STEP_NS, Tally, tally_of_frame)

FRAMES = 100
START_IDENTIFICATIONS = 2
_GYRO_STEP_NS = 10_000_000
_ORBIT = CircularOrbit(EARTH_RADIUS_M + 700e3, 0.5, 0.0, 0.0)
_VIBRATION_HZ = 7.3
_KICK_PERIOD_S = 0.15
# The fastest condition turns at 10 deg/s, the largest rate that the tracker accepts by default.
_TRACKER = TrackerOptions(max_rate_deg_s=15.0)


@dataclass(frozen=True)
class ImageCondition:
    """
    What the images of a run contain.

    The camera turns at rate_deg_s about a random axis, with a sway of sway_deg in sway_s about
    another one, a vibration of vibration_arcsec and kicks of kick_arcsec, one in 0.15 s on
    average. The first clean_frames are of clean_detector
    and without artefacts: the tracker tracks when these begin. line_time_us is the parameter of
    the extraction. Frames are due after clean_frames, or after the two identifications of a start;
    with start, each run is due once: within its frames. needed_percent of what is due must have
    an attitude. Without detectable, no image shows the error: only its size is measured.
    """

    rate_deg_s: float = 0.1
    vibration_arcsec: float = 0.0
    kick_arcsec: float = 0.0
    sway_deg: float = 0.0
    sway_s: float = 1.0
    detector: DetectorOptions = DetectorOptions()
    artefacts: ArtefactOptions = ArtefactOptions()
    line_time_us: float = 0.0
    gyro: bool = False
    clean_frames: int = 0
    start: bool = False
    frames: int = FRAMES
    needed_percent: float = 99.0
    detectable: bool = True
    clean_detector: DetectorOptions = DetectorOptions()

    @property
    def is_shaken(self) -> bool:
        """Whether the camera vibrates or is kicked: the truth is then the mean pointing."""
        return self.vibration_arcsec > 0 or self.kick_arcsec > 0


@cache
def _pipeline(camera: Camera, line_time_us: float) -> StarTracker:
    return StarTracker.with_options(camera, EPOCH_YEAR, StarTrackerOptions(
        extraction=ExtractionOptions(line_time_us=line_time_us), tracker=_TRACKER))


def image_run(condition: ImageCondition, seed: int, camera: Camera = CAMERA) -> Tally:
    """Run the pipeline through the images of one run and tally what it publishes."""
    due_from = condition.clean_frames or START_IDENTIFICATIONS
    tally, before = Tally(), TrackerState.LOST
    for index, (frame, taken) in enumerate(image_frames(condition, seed, camera)):
        tally += tally_of_frame(frame, before, taken.q_mean, taken.mean_rate_rad_s,
                                index >= due_from and not condition.start)
        before = frame.state
    if condition.start:
        tally = replace(tally, due=1, available=int(tally.published > 0))
    return tally


def image_frames(condition: ImageCondition, seed: int, camera: Camera = CAMERA
                 ) -> Iterator[tuple[FrameResult, Frame]]:
    """Yield what the pipeline has of each image of one run, and the image with its truth."""
    pipeline = _pipeline(camera, condition.line_time_us)
    pipeline.reset()
    clean, contaminated = _simulators(condition, seed, camera)
    for index in range(condition.frames):
        if condition.gyro and index:
            for step_ns in range((index - 1) * STEP_NS, index * STEP_NS, _GYRO_STEP_NS):
                time_ns = step_ns + _GYRO_STEP_NS
                pipeline.add_rate(START_NS + time_ns, contaminated.gyro(time_ns * 1e-9))
        simulator = clean if index < condition.clean_frames else contaminated
        taken = simulator.frame(round(index * STEP_NS * 1e-9, 9))
        pipeline.motion.add_state(START_NS + index * STEP_NS, taken.state.geocentric)
        yield pipeline.process(START_NS + index * STEP_NS, taken.image), taken


def _simulators(condition: ImageCondition, seed: int, camera: Camera
                ) -> tuple[SkySimulator, SkySimulator]:
    """Return the simulators of the images without artefacts and with them, in one motion."""
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    rate_rad_s = np.radians(condition.rate_deg_s) * axis / np.linalg.norm(axis)
    motion: Motion = SteadyMotion(random_attitude(rng), rate_rad_s, _ORBIT)
    if condition.sway_deg:
        axis = rng.standard_normal(3)
        motion = SwayingMotion(motion, axis / np.linalg.norm(axis), np.radians(condition.sway_deg),
                               condition.sway_s, rng.uniform(0, 2 * np.pi))
    if condition.vibration_arcsec or condition.kick_arcsec:
        motion = ShakenMotion(motion, condition.vibration_arcsec * ARCSEC, _VIBRATION_HZ,
                              condition.kick_arcsec * ARCSEC, _KICK_PERIOD_S, seed)
    clean, contaminated = (
        SkySimulator(camera, motion, load_catalog(), EPOCH_YEAR, detector_options=detector,
                     artefact_options=artefacts, frame_rate_hz=1e9 / STEP_NS, seed=seed)
        for detector, artefacts in ((condition.clean_detector, ArtefactOptions()),
                                    (condition.detector, condition.artefacts)))
    return clean, contaminated


# --- availability under glare, with bright bodies in the field, under protons ---

STRAY_LIGHT_E = (500.0, 2000.0, 5000.0, 10_000.0)
PROTONS_CM2_S = (5.0, 1000.0, 10_000.0, 100_000.0)

_CLEAN_FRAMES = 10


class Disturbance(NamedTuple):
    """A name, and the options of detector and artefacts that differ from the clean ones."""

    name: str
    detector: dict[str, Any]
    artefacts: ArtefactOptions = ArtefactOptions()


DISTURBANCES = (
    *(Disturbance(f'glare of Sun, Moon or Earth, {level:g} e- at the edge of the image',
                  {'stray_light_e': level}) for level in STRAY_LIGHT_E),
    Disturbance('full Moon in the field, 2 deg off the boresight', {'blooming': True},
                ArtefactOptions(moon_e=40_000.0, moon_distance_deg=2.0)),
    Disturbance('limb of the bright Earth in the field, 4 deg off the boresight', {},
                ArtefactOptions(earth_e=20_000.0)),
    *(Disturbance(f'protons, {flux:g} hits/cm^2/s', {'cosmic_ray_hits_cm2_s': flux})
      for flux in PROTONS_CM2_S))


def disturbed_runs(instrument: Instrument, disturbance: Disturbance, frames: int, runs: int,
                   seed: int) -> Tally:
    """Return the tally of so many runs that begin undisturbed."""
    detector: DetectorOptions = replace(instrument.detector, **disturbance.detector)
    condition = ImageCondition(
        detector=detector, artefacts=disturbance.artefacts, clean_frames=_CLEAN_FRAMES,
        frames=_CLEAN_FRAMES + frames, clean_detector=instrument.detector)
    return sum((image_run(condition, seed + run, instrument.lens) for run in range(runs)), Tally())
