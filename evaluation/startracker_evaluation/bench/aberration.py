# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitudes of noise-free images over a year, in any orbit, with and without odometry."""

from collections.abc import Iterator

import numpy as np
from rich.progress import track as progress
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, random_attitude
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import SteadyMotion
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.rows import Row

YEAR = 2026.0
EPOCHS = 12
CAMERA = Camera.from_fov(1024, 1024, 12.0)
LOW_KM, GEOSTATIONARY_KM = (200.0, 2000.0), (200.0, 35786.0)
_DETECTOR = DetectorOptions(noise=False, bit_depth=16, gain_e_per_dn=0.25)
MOST_BIAS_ARCSEC = 0.005
LEAST_WITHIN_PERCENT = 99.5


def _motion(heights_km: tuple[float, float], rng: np.random.Generator) -> SteadyMotion:
    """Return a random attitude at rest on a random circular orbit."""
    height_m = 1e3 * np.exp(rng.uniform(*np.log(heights_km)))
    inclination_rad = np.arccos(rng.uniform(-1, 1))
    return SteadyMotion(random_attitude(rng), np.zeros(3), CircularOrbit(
        EARTH_RADIUS_M + height_m, inclination_rad, *rng.uniform(0, 2 * np.pi, 2)))


def attitudes(odometry: bool, trials: int, seed: int
              ) -> Iterator[tuple[AttitudeEstimate | None, MotionState]]:
    """Yield the attitude and the truth of each image."""
    rng = np.random.default_rng(seed)
    name = f'{"with" if odometry else "without"} odometry'
    catalog = load_catalog()
    for epoch in progress(range(EPOCHS), name, transient=True):
        year = YEAR + (epoch + rng.uniform()) / EPOCHS
        stamp_ns = stamp_from_epoch_year(year)
        pipeline = StarTracker(CAMERA, year)
        for _ in range(-(-trials // EPOCHS)):
            motion = _motion(GEOSTATIONARY_KM if odometry else LOW_KM, rng)
            frame = SkySimulator(CAMERA, motion, catalog, year,
                                 detector_options=_DETECTOR).frame(0.0)
            if odometry:
                pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
            centroids = pipeline.extraction.extractor.measure(frame.image).centroids
            found = pipeline.identify(stamp_ns, centroids)
            solved = pipeline.attitude.from_stars(stamp_ns, centroids, found.hip)
            yield solved.attitude, frame.state


def errors_and_sigmas(odometry: bool, trials: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (N, 3) about sensor axes and their sigmas (N, 3), NaN without attitude."""
    error, sigma = [], []
    for attitude, truth in attitudes(odometry, trials, seed):
        nothing = np.full(3, np.nan)
        error.append(nothing if attitude is None else attitude_error(
            attitude.quaternion, truth.q_icrf_from_sensor))
        sigma.append(nothing if attitude is None else np.sqrt(np.diag(
            attitude.covariance_sensor)))
    return np.array(error) / ARCSEC, np.array(sigma) / ARCSEC


def run_aberration_bench(*, trials: int, seed: int) -> Result:
    """Measure the bias with odometry, and the covariance without."""
    error, _ = errors_and_sigmas(True, trials, seed)
    across = error[np.isfinite(error[:, 0]), :2]
    bias = float(np.hypot(*across.mean(axis=0)))
    unknown, sigma = errors_and_sigmas(False, trials, seed + 1)
    within = 100 * float(np.mean(np.all(np.abs(unknown) <= 3 * sigma, axis=1)))
    distance = np.hypot(*unknown[:, :2].T)
    table = [
        Row('with odometry, 200 to 35786 km: bias of the boresight', bias, 'arcsec',
            most=MOST_BIAS_ARCSEC),
        Row('with odometry: error of the boresight, rms',
            float(np.sqrt(np.mean(across ** 2))), 'arcsec'),
        Row('with odometry: error of the boresight, largest', float(np.hypot(*across.T).max()),
            'arcsec'),
        Row('with odometry: frames with attitude', 100 * len(across) / len(error), '%'),
        Row('without odometry, 200 to 2000 km: all axes within 3 sigma', within, '%',
            least=LEAST_WITHIN_PERCENT),
        Row('without odometry: error of the boresight, largest', float(np.nanmax(distance)),
            'arcsec'),
        Row('without odometry: published sigma across the boresight, median',
            float(np.nanmedian(sigma[:, :2])), 'arcsec')]
    return Result('bench aberration', table, {
        'images': f'{CAMERA.width} x {CAMERA.height} uint16 without noise, 12 deg field, random '
                  f'attitudes and circular orbits at {EPOCHS} random epochs of {YEAR:.0f}',
        'attitude': 'of single frames, against the true attitude of the simulator; aberration '
                    'full with odometry, earth_only without',
        'trials': len(error), 'seed': seed})
