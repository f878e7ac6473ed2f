# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs of images through the whole star tracker: acquisition, error, limits of the motion."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.maths.rotation import attitude_error, random_attitude
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.datasheet.instrument import (
    across_boresight, EPOCH_YEAR, FRAME_RATE_HZ, Instrument, RUN_S, Spins, START_NS)
from startracker_ros.tools.figures.correctness import count_wrong, nees_of, WrongCount

SETTLED_FRAMES = 10
"""Frames after which the filter of the tracker no longer depends on its start."""


@dataclass(frozen=True)
class RunCase:
    """
    A motion across the boresight, lost in space at its start.

    The rate grows by acceleration_deg_s2 from frame SETTLED_FRAMES on.
    """

    rate_deg_s: float
    acceleration_deg_s2: float = 0.0
    frames: int = 30


@dataclass(frozen=True)
class Runs:
    """
    What runs (R,) of F frames published.

    error and protection (R, F, 3) rad and covariance (R, F, 3, 3) rad^2 are about sensor axes, NaN
    without an attitude; acquired_s (R,) is the time of the first attitude after the first image,
    infinite without one.
    """

    error: np.ndarray
    covariance: np.ndarray
    protection: np.ndarray
    acquired_s: np.ndarray

    @property
    def settled(self) -> np.ndarray:
        """Return the errors after SETTLED_FRAMES."""
        return self.error[:, SETTLED_FRAMES:]

    def wrong(self, bias_rad: np.ndarray) -> WrongCount:
        """Return how many attitudes are wrong without the bias (3,), which alignment removes."""
        sigma = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return count_wrong(self.error - bias_rad, sigma)

    def beyond_protection(self, bias_rad: np.ndarray) -> int:
        """Return how many errors but for the bias (3,) exceed their protection level."""
        beyond = np.abs(self.error - bias_rad) > self.protection
        return int(np.count_nonzero(beyond.any(axis=-1)))

    def nees(self, bias_rad: np.ndarray) -> float | None:
        """Return the mean normalised squared error but for the bias (3,), None of no frame."""
        known = np.isfinite(self.settled[..., 0])
        error = self.settled[known] - bias_rad
        covariance = self.covariance[:, SETTLED_FRAMES:][known]
        return float(nees_of(error, covariance).mean()) if len(error) else None

    @property
    def published(self) -> int:
        """Return the number of frames with an attitude."""
        return int(np.count_nonzero(np.isfinite(self.error[..., 0])))

    @property
    def available_percent(self) -> float:
        """Return the percentage of the frames after SETTLED_FRAMES with an attitude."""
        return 100 * float(np.mean(np.isfinite(self.settled[..., 0])))


@cache
def _pipeline(instrument: Instrument) -> StarTracker:
    # Limits of the motion are to be those of images and filter, not of this parameter.
    return StarTracker(instrument.camera, EPOCH_YEAR, max_rate_deg_s=100.0)


def tracked_runs(instrument: Instrument, case: RunCase, runs: int, seed: int) -> Runs:
    """Return what the tracker publishes in runs at random attitudes."""
    rng = np.random.default_rng(seed)
    motion = Spins(np.array([random_attitude(rng) for _ in range(runs)]),
                   across_boresight(rng, runs), float(np.radians(case.rate_deg_s)),
                   float(np.radians(case.acceleration_deg_s2)), SETTLED_FRAMES / FRAME_RATE_HZ)
    simulator = SkySimulator(instrument.lens, motion, camera_catalog(instrument.lens), EPOCH_YEAR,
                             detector_options=instrument.detector, seed=seed)
    rows = [_run(simulator, _pipeline(instrument), run * RUN_S, case.frames)
            for run in range(runs)]
    return Runs(*map(np.array, zip(*rows)))


def _run(simulator: SkySimulator, pipeline: StarTracker, begin_s: float, frames: int
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the fields of Runs of one run."""
    pipeline.reset()
    error, protection = np.full((2, frames, 3), np.nan)
    covariance = np.full((frames, 3, 3), np.nan)
    for index in range(frames):
        time_s = begin_s + index / FRAME_RATE_HZ
        taken = simulator.frame(time_s)
        stamp_ns = START_NS + round(time_s * 1e9)
        pipeline.motion.add_state(stamp_ns, taken.state.geocentric)
        attitude = pipeline.process(stamp_ns, taken.image).attitude
        if attitude is not None:
            error[index] = attitude_error(attitude.quaternion, taken.state.q_icrf_from_sensor)
            covariance[index] = attitude.covariance_sensor
            protection[index] = attitude.protection_rad
    published = np.flatnonzero(np.isfinite(error[:, 0]))
    return (error, covariance, protection,
            published[0] / FRAME_RATE_HZ if len(published) else np.inf)
