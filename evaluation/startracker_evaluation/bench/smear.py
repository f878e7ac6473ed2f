# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Centroids of smeared stars against the Cramer-Rao bound of the simulator's images."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from rich.progress import track as progress
from scipy.spatial import cKDTree
from startracker_evaluation.bench.star_images import flux_above
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import CATALOG_EPOCH_YEAR, StarCatalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.maths.rotation import radec_from_unit, random_attitude, rotate
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import SteadyMotion
from startracker_ros.sim.sky.simulator import Frame, SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

STREAKS_PX = (2.0, 5.0, 10.0, 20.0)
SNRS = (10.0, 30.0, 100.0)
AIM = 1.2
STARS = 25
_CAMERA = Camera.from_fov(512, 512, 6.0)
_ORBIT = CircularOrbit(EARTH_RADIUS_M + 700e3, 0.5, 0.0, 0.0)
_DETECTOR = DetectorOptions(motion_smear=True)
_NOISE_E2 = (_DETECTOR.background_e + _DETECTOR.read_noise_e ** 2
             + _DETECTOR.gain_e_per_dn ** 2 / 12)
_AXES = ('along', 'across')
_CELL_PX = 80
_MARGIN_PX = 10  # of a window around half a streak
_MATCH_PX = 3.0
_STEP_PX = 0.05
_EXPECTED_E = 2e4
# A star of many electrons in fine steps, as the light of stars is proportional to their flux.
_EXPECTED = replace(_DETECTOR, noise=False, background_e=0.0, bias_dn=0.0, bit_depth=16,
                    gain_e_per_dn=0.25, full_well_e=1e6)


@dataclass(frozen=True)
class SmearRow:
    """Error of the stars found along or across their streaks, rms, and its bound."""

    streak_px: float
    snr: float
    axis: str
    found_percent: float
    ours_px: float
    bound_px: float
    ratio: float
    bound: str
    holds: bool


@dataclass(frozen=True)
class Errors:
    """Errors (F, 2) and bounds (F, 2) of the found stars, px along and across; all stars."""

    error_px: np.ndarray
    bound_px: np.ndarray
    stars: int


@dataclass(frozen=True)
class Scene:
    """Stars at uv (N, 2) px at the middle of an exposure in which they move by streak_px (2,)."""

    uv: np.ndarray
    streak_px: np.ndarray
    quaternion: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        """Return the unit vectors (2, 2) along the streak and across it."""
        along = self.streak_px / np.linalg.norm(self.streak_px)
        return np.array([along, [-along[1], along[0]]])

    def frame(self, detector: DetectorOptions, flux_e: float, seed: int = 0) -> Frame:
        """Return the image of the stars, each of flux_e."""
        ra, dec = radec_from_unit(rotate(self.quaternion, _CAMERA.unproject(self.uv)))
        zero, number = np.zeros(len(self.uv)), np.arange(1, len(self.uv) + 1)
        catalog = StarCatalog(number, ra, dec, *[zero] * 6)
        # Stars move by (-wy, wx) f on the image.
        du, dv = self.streak_px / _CAMERA.fx / detector.exposure_s
        motion = SteadyMotion(self.quaternion, np.array([dv, -du, 0.0]), _ORBIT)
        detector = replace(detector, zero_flux_e_s=flux_e / detector.exposure_s)
        return SkySimulator(_CAMERA, motion, catalog, CATALOG_EPOCH_YEAR,
                            detector_options=detector, seed=seed,
                            sky_options=SkyOptions(aberration=False)).frame(0.0)

    def shares(self, shift_px: np.ndarray) -> np.ndarray:
        """Return the share of the light (N, n, n) in a window at each star, all shifted (2,)."""
        image = replace(self, uv=self.uv + shift_px).frame(_EXPECTED, _EXPECTED_E).image
        half = int(np.ceil(np.linalg.norm(self.streak_px) / 2)) + _MARGIN_PX
        window = np.arange(-half, half + 1)
        column, row = np.rint(self.uv).astype(int).T[..., None] + window
        light_e = image[row[:, :, None], column[:, None, :]] * _EXPECTED.gain_e_per_dn
        return light_e / _EXPECTED_E


def random_scene(length_px: float, rng: np.random.Generator) -> Scene:
    """Return stars in cells of a grid, not near one another, with streaks of one direction."""
    side = int(np.sqrt(STARS))
    grid = np.stack(np.meshgrid(*[np.arange(side) - (side - 1) / 2] * 2), -1).reshape(-1, 2)
    uv = (_CAMERA.width - 1) / 2 + grid * _CELL_PX + rng.uniform(-10, 10, grid.shape)
    angle = rng.uniform(0, 2 * np.pi)
    return Scene(uv, length_px * np.array([np.cos(angle), np.sin(angle)]), random_attitude(rng))


def flux_of(snr: float, share: np.ndarray) -> float:
    """
    Return the electrons of a star of this SNR, of which a pixel has share (n, n).

    SNR is F / sqrt(F + P noise^2) with the noise of a pixel and P = 1 / sum(share^2) pixels.
    """
    return flux_above(snr, _NOISE_E2 / np.sum(share ** 2))


def bounds_px(scene: Scene, share: np.ndarray, flux_e: float) -> np.ndarray:
    """
    Return the bound of the errors (N, 2) along and across: flux and position free.

    share (N, n, n) is that of shares(0); its derivatives are those of the expected image.
    """
    slopes = [flux_e * (scene.shares(axis * _STEP_PX) - scene.shares(-axis * _STEP_PX))
              / (2 * _STEP_PX) for axis in scene.axes]
    design = np.stack([*slopes, share], 1).reshape(len(share), 3, -1)
    variance = (flux_e * share + _NOISE_E2).reshape(len(share), 1, -1)
    covariance = np.linalg.inv(design / variance @ design.transpose(0, 2, 1))
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :2])


def measure(length_px: float, snr: float, trials: int, seed: int) -> Errors:
    """Extract stars of one SNR and length from so many images."""
    rng = np.random.default_rng((seed, round(length_px), round(snr)))
    extractor, error_px, bound_px = CentroidExtractor(), [], []
    for trial in range(trials):
        scene = random_scene(length_px, rng)
        share = scene.shares(np.zeros(2))
        flux_e = flux_of(snr, share[0])
        image = scene.frame(_DETECTOR, flux_e, seed=trial + 1).image
        uv = extractor.measure(image).centroids.uv
        if not len(uv):
            continue
        distance, index = cKDTree(uv).query(scene.uv)
        near = distance < _MATCH_PX
        error_px.append((uv[index] - scene.uv)[near] @ scene.axes.T)
        bound_px.append(bounds_px(scene, share, flux_e)[near])
    empty = np.empty((0, 2))
    return Errors(np.concatenate([*error_px, empty]), np.concatenate([*bound_px, empty]),
                  trials * STARS)


def rows(length_px: float, snr: float, errors: Errors) -> Iterator[SmearRow]:
    """Yield the row along and the one across."""
    found = 100 * len(errors.error_px) / errors.stars
    for axis, error_px, bound_px in zip(_AXES, errors.error_px.T, errors.bound_px.T):
        ours, bound, ratio = (
            float(np.sqrt(np.mean(values ** 2))) if len(values) else np.nan
            for values in (error_px, bound_px, error_px / bound_px))
        yield SmearRow(length_px, snr, axis, found, ours, bound, ratio, f'ratio <= {AIM:g}',
                       ratio <= AIM)


def run_smear_bench(*, trials: int, seed: int) -> Result:
    """Measure each length of the streaks at each SNR."""
    cases = [(length_px, snr) for length_px in STREAKS_PX for snr in SNRS]
    table = [row for case in progress(cases, 'smear', transient=True)
             for row in rows(*case, measure(*case, trials, seed))]
    return Result('bench smear', table, {
        'images': f'{_CAMERA.width} x {_CAMERA.height} uint16, {STARS} stars that move together '
                  f'along a line in a random direction, sigma {_DETECTOR.psf_sigma_px:g} px, sky '
                  f'{_DETECTOR.background_e:g} e-, read noise {_DETECTOR.read_noise_e:g} e-, '
                  f'{_DETECTOR.gain_e_per_dn:g} e-/DN',
        'snr': 'F / sqrt(F + P noise^2), F the electrons of the star, P = 1 / sum(share^2) its '
               'pixels, noise that of a pixel without stars',
        'ratio': 'rms of the errors, each over the Cramer-Rao bound of its star: x, y and flux '
                 'free; the derivatives are those of the expected image of the simulator',
        'found': f'a centroid within {_MATCH_PX:g} px; no image is searched with a prediction',
        'trials': trials, 'seed': seed})
