# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Runs of four stars in 400 frames, in cells of two motions, three jitters and three noises.

Sadeghi, Sabahi, Saberali.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import (
    conjugate, matrix_from_quaternion, quaternion_from_pointing, radec_from_unit, rotate)
from startracker_ros.sim.sky.motion import RollJitter, SteadyMotion
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions

CAMERA = Camera.from_fov(1024, 1024, 12.0)
EPOCH_YEAR = 2026.5
MAGNITUDE_LIMIT = 6.5
STARS = 4
FRAMES = 400
DT_S = 0.1
ORBIT_RATE_RAD_S = 2 * np.pi / (90 * 60)
BLOCK_S = 1.0
DETECTION_PROBABILITY = 0.99
FALSE_POINTS = 100
GYRO = GyroOptions()
"""Errors of the rates that measure the jitter."""

_MARGIN_PX = 2.0


@dataclass(frozen=True)
class Cell:
    """One cell of the paper: motion, largest jitter, variance of a centroid per axis."""

    motion: str
    jitter_deg_s: float
    variance_px2: float

    def __str__(self) -> str:
        return f'{self.motion}, {self.jitter_deg_s:g} deg/s, {self.variance_px2:g} px^2'

    @property
    def sigma_px(self) -> float:
        """Return the 1-sigma error of a centroid per axis."""
        return float(np.sqrt(self.variance_px2))


def _published(motion: str, variances: Sequence[float],
               rows: dict[float, Sequence[tuple[float, float]]]
               ) -> dict[Cell, tuple[float, float]]:
    return {Cell(motion, jitter, variance): errors for jitter, row in rows.items()
            for variance, errors in zip(variances, row)}


# Error in arcsec of (SNA, JPDAF).
PUBLISHED = {
    **_published('turning', (0.03, 0.02, 0.017), {
        0.0: ((8.0991, 5.1795), (6.6433, 3.9034), (6.0949, 3.5355)),
        0.1: ((8.1976, 5.2635), (6.7340, 4.6070), (6.1309, 4.0206)),
        0.5: ((8.2579, 5.4272), (6.7701, 4.8831), (6.1898, 4.1511))}),
    **_published('linear', (0.02, 0.01, 0.005), {
        0.0: ((6.5629, 4.1759), (4.6858, 2.8970), (3.3236, 2.1090)),
        0.1: ((6.5730, 4.1766), (4.6765, 2.8772), (3.3286, 2.1445)),
        0.5: ((6.5740, 4.2746), (4.6878, 2.8979), (3.3296, 2.1590))})}


@dataclass(frozen=True)
class Run:
    """
    The truth of one run, its four stars and its centroids.

    quaternion (F, 4) and rate_rad_s (F, 3) are the truth at each frame; icrf (4, 3) the
    stars; gyro_rad_s (F - 1, 3) the measured mean rates between the frames; seen (F, 4) the
    index of each star among the centroids of a frame, -1 where it is missing; centroids
    holds (M, 2) px of each frame.
    """

    cell: Cell
    quaternion: np.ndarray
    rate_rad_s: np.ndarray
    icrf: np.ndarray
    gyro_rad_s: np.ndarray
    seen: np.ndarray
    centroids: list[np.ndarray]

    @property
    def start(self) -> np.ndarray:
        """Return the stars (4, 2) px of the first frame, identified lost in space."""
        return self.centroids[0][self.seen[0]]

    @property
    def uv(self) -> np.ndarray:
        """Return the true places (F, 4, 2) of the stars in px."""
        # Row vectors times R are R^T d: the directions on sensor axes.
        return CAMERA.project(self.icrf @ matrix_from_quaternion(self.quaternion))


@cache
def _onboard() -> OnboardCatalog:
    return onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR, MAGNITUDE_LIMIT)


def make_run(cell: Cell, rng: np.random.Generator) -> Run:
    """Return a run over the four brightest stars that stay in the image, anywhere in the orbit."""
    onboard = _onboard()
    while True:
        quaternion, rate = _motion(cell, rng)
        axes = matrix_from_quaternion(quaternion)
        near = onboard.within(axes[FRAMES // 2, :, 2], CAMERA.corner_angle_rad)
        icrf = onboard.direction[near[~onboard.crowded[near]]]
        # Row vectors times R are R^T d: the directions on sensor axes.
        uv = CAMERA.project(icrf @ axes)
        chosen = np.flatnonzero(CAMERA.contains(uv, _MARGIN_PX).all(axis=0))[:STARS]
        if len(chosen) == STARS:
            break
    seen, centroids = sightings(uv[:, chosen], cell.sigma_px, rng)
    gyro = Gyro(GYRO, rng=rng)
    # The rate of a frame holds until the next one, up to the turn of the axes in that time.
    measured = np.stack([gyro.measure(each, DT_S) for each in rate[:-1]])
    return Run(cell, quaternion, rate, icrf[chosen], measured, seen, centroids)


def _motion(cell: Cell, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """
    Return attitudes and body rates of the frames.

    The camera keeps its attitude to the orbit. Along the orbit normal the image turns about its
    centre; to the zenith the stars run on nearly straight lines.
    """
    orbit = CircularOrbit(EARTH_RADIUS_M + 700e3, np.radians(30.0),
                          *rng.uniform(0, 2 * np.pi, 2))
    boresight = orbit.normal if cell.motion == 'turning' else orbit.at(0.0)[0]
    ra_rad, dec_rad = map(float, radec_from_unit(boresight))
    q_start = quaternion_from_pointing(ra_rad, dec_rad, rng.uniform(0, 2 * np.pi))
    steady_rate = rotate(conjugate(q_start), ORBIT_RATE_RAD_S * orbit.normal)
    motion = RollJitter(SteadyMotion(q_start, steady_rate, orbit),
                        np.radians(cell.jitter_deg_s), BLOCK_S, int(rng.integers(2 ** 32)))
    states = [motion.at(k * DT_S) for k in range(FRAMES)]
    return (np.stack([state.q_icrf_from_sensor for state in states]),
            np.stack([state.rate_rad_s for state in states]))


def sightings(uv: np.ndarray, sigma_px: float, rng: np.random.Generator
              ) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return seen and centroids as of Run, of stars at uv (F, N, 2); all are in the first."""
    found = rng.random(uv.shape[:2]) < DETECTION_PROBABILITY
    found[0] = True
    measured = uv + rng.normal(0, sigma_px, uv.shape)
    seen = np.full(uv.shape[:2], -1)
    centroids = []
    for row, detected, uv_stars in zip(seen, found, measured):
        false = rng.uniform(-0.5, [CAMERA.width - 0.5, CAMERA.height - 0.5],
                            (rng.poisson(FALSE_POINTS), 2))
        order = rng.permutation(detected.sum() + len(false))
        frame = np.empty((len(order), 2))
        frame[order] = np.concatenate([uv_stars[detected], false])
        row[detected] = order[:detected.sum()]
        centroids.append(frame)
    return seen, centroids
