# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulated nights of unknown lenses, mostly fisheyes: how many are solved, and whether any wrongly.

Each draw has a lens of its own: one of five projections, a circle of 100 to 190 deg, off centre
and partly cropped, in an image of one of three shapes. Its axis is up to 75 deg from the zenith.
It sees stars to V 4 to 5 above an uneven horizon and outside the glare of the Moon, dimmed by the
air, with a noise of 0.3 to 1 px, and 30 false detections: the Moon, lamps along the horizon,
the rest anywhere. A cropped image is a part, anywhere, of one of a distorted rectilinear lens. The
solver of photographs is given the star list and the shape of the image, nothing else. Lists
without a sky, and mirrored and shuffled nights, must have no answer. Images of an all-sky camera
through a night, each solved by itself, must have the horizon at the same radius.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import time
from typing import NamedTuple

import numpy as np
from startracker_evaluation.campaign.lenses import draw_stars, EPOCH_YEAR, unfolded
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    conjugate, matrix_from_quaternion, multiply, quaternion_from_rotation_vector, random_attitude,
    rotate)
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.table import Result
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.parallel import joined, parallel_trials

SHAPES = (1000, 1000), (960, 1280), (1080, 1920)
FOV_DEG, RADIUS, CENTRE, TILT_DEG = (100.0, 190.0), (0.85, 1.4), 0.1, 75.0
MAGNITUDE, NOISE_PX, FALSE, LAMPS = (4.0, 5.0), (0.3, 1.0), 30, 9
_EXTINCTION, _SCATTER, _MISSING, _GLARE_DEG = 0.2, 0.3, 0.05, 10.0
# An all-sky camera through a night: deviations of its radius, as a share of that of the horizon,
# in the three terms of Hugin and Lensfun.
_DEVIATION, _NIGHT_TILT_DEG, _NIGHT_HOURS, _SKY_DEG_PER_HOUR = 0.01, 8.0, 8.0, 15.041
_CLOUD_DEG, _MOST_CLOUDS, _HAZE_DEG = 15.0, 12, (5.0, 35.0)
CROPPED_DEG, CROPPED_K1, CROPPED, CROPPED_STARS = (60.0, 100.0), (-0.2, 0.1), (0.5, 0.8), (25, 60)
_CROPPED_OF, _CROPPED_FALSE = (2000, 1500), 12
_CORRECT_PX = 3.0  # median error of the stars in the fitted lens
_TIME_S = 5.0
_SCATTER_PERCENT = 2.0  # of the horizon over a night
_PART_TRIALS = 25


def _polynomial(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Return a random radial polynomial that grows up to 95 deg."""
    while True:
        a, b = rng.uniform(-0.1, 0.06), rng.uniform(-0.015, 0.01)
        theta = np.radians(95.0) * np.linspace(0, 1, 50)
        if (1 + 3 * a * theta ** 2 + 5 * b * theta ** 4 > 0.2).all():
            return lambda angle: angle * (1 + a * angle ** 2 + b * angle ** 4)


PROJECTIONS: dict[str, Callable[[np.random.Generator], Callable[[np.ndarray], np.ndarray]]] = {
    'equidistant': lambda rng: lambda theta: theta,
    'equisolid': lambda rng: lambda theta: 2 * np.sin(theta / 2),
    'stereographic': lambda rng: lambda theta: 2 * np.tan(theta / 2),
    'orthographic': lambda rng: lambda theta: np.sin(np.minimum(theta, np.pi / 2)),
    'polynomial': _polynomial}
"""r / f of the angle to the axis, by the name of the projection; drawn where it is random."""


@dataclass(frozen=True)
class FisheyeNight:
    """
    The spots in an image of shape (H, W) px, and the stars among them.

    direction (N, 3) are those of the stars in ICRS, uv (N, 2) their pixels without errors.
    """

    shape: tuple[int, int]
    centroids: Centroids
    direction: np.ndarray
    uv: np.ndarray

    def error_px(self, sky: SkyMapping) -> float:
        """Return the median distance of the stars in a solved image from their pixels."""
        apart = np.linalg.norm(sky.pixels(self.direction) - self.uv, axis=1)
        return float(np.median(np.where(np.isnan(apart), np.inf, apart)))


@dataclass(frozen=True)
class Fisheye:
    """A lens with radial(angle) = r / f in an image of shape (H, W) px; half_rad is its circle."""

    shape: tuple[int, int]
    radial: Callable[[np.ndarray], np.ndarray]
    half_rad: float
    focal_px: float
    centre: np.ndarray

    def radius_px(self, theta: np.ndarray) -> np.ndarray:
        """Return the distances from the centre (N,) at angles to the axis (N,)."""
        return self.focal_px * self.radial(theta)

    def pixels(self, sensor: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 2) of unit vectors (N, 3)."""
        theta = np.arccos(np.clip(sensor[:, 2], -1, 1))
        across = sensor[:, :2] / np.maximum(np.linalg.norm(sensor[:, :2], axis=1), 1e-12)[:, None]
        return self.centre + self.radius_px(theta)[:, None] * across

    def shows(self, sensor: np.ndarray) -> np.ndarray:
        """Return which unit vectors (N, 3) are in the circle and in the image."""
        height, width = self.shape
        uv = self.pixels(sensor)
        return ((sensor[:, 2] > np.cos(self.half_rad))
                & (uv > 0).all(1) & (uv < [width - 1, height - 1]).all(1))


class Scene(NamedTuple):
    """
    The sky over a camera, in sensor axes but for the attitude q_icrf_from_sensor.

    Stars to a magnitude are seen; hills_rad is the phase of the hills around the camera; clouds
    (N, 3) are their middles, haze_rad is how high they reach all around.
    """

    zenith: np.ndarray
    moon: np.ndarray
    magnitude: float
    attitude: np.ndarray
    hills_rad: float
    clouds: np.ndarray = np.empty((0, 3))
    haze_rad: float = 0.0


def draw_fisheye(rng: np.random.Generator, projection: str) -> Fisheye:
    """Return a random fisheye of a projection."""
    shape = height, width = SHAPES[rng.integers(len(SHAPES))]
    radial = PROJECTIONS[projection](rng)
    half_rad = np.radians(rng.uniform(
        FOV_DEG[0], 180.0 if projection == 'orthographic' else FOV_DEG[1])) / 2
    focal_px = float(min(shape) / 2 * rng.uniform(*RADIUS) / radial(half_rad))
    centre = (np.array([width - 1, height - 1]) / 2
              + rng.uniform(-CENTRE, CENTRE, 2) * min(shape))
    return Fisheye(shape, radial, half_rad, focal_px, centre)


def draw_scene(rng: np.random.Generator, tilt_deg: float = TILT_DEG) -> Scene:
    """Return a random sky over a camera whose axis is up to tilt_deg from the zenith."""
    tilt, towards = np.radians(tilt_deg) * rng.uniform(), rng.uniform(0, 2 * np.pi)
    zenith = np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards),
                       np.cos(tilt)])
    return Scene(zenith, random_directions(rng, 1)[0], rng.uniform(*MAGNITUDE),
                 random_attitude(rng), rng.uniform(0, 2 * np.pi))


def draw_night(rng: np.random.Generator, projection: str) -> FisheyeNight:
    """Return what a random fisheye of a projection sees of a random sky."""
    fisheye = draw_fisheye(rng, projection)
    return draw_image(rng, fisheye, draw_scene(rng))


def draw_image(rng: np.random.Generator, fisheye: Fisheye, scene: Scene) -> FisheyeNight:
    """Return what a fisheye sees."""
    height, width = fisheye.shape
    zenith, moon, limit, attitude, hills_rad, clouds, haze_rad = scene
    catalog = load_catalog().brighter_than(limit)
    icrf = catalog.directions(EPOCH_YEAR)
    sensor = icrf @ matrix_from_quaternion(attitude)
    elevation = np.arcsin(np.clip(sensor @ zenith, -1, 1))
    # Hills and trees hide up to 12 deg above the horizon.
    hills = np.radians(6 + 6 * np.sin(3 * np.arctan2(sensor[:, 1], sensor[:, 0]) + hills_rad))
    seen = (fisheye.shows(sensor) & (elevation > np.maximum(hills, haze_rad))
            & (sensor @ moon < np.cos(np.radians(_GLARE_DEG)))
            & ~(sensor @ clouds.T > np.cos(np.radians(_CLOUD_DEG))).any(axis=1)
            & (rng.uniform(size=len(sensor)) > _MISSING))
    magnitude = (catalog.magnitude[seen] + rng.normal(0, _SCATTER, np.count_nonzero(seen))
                 + _EXTINCTION / np.sin(np.maximum(elevation[seen], 0.05)))
    flux = 10 ** (-0.4 * magnitude)
    bright = flux.max(initial=1.0)
    lamps = random_directions(rng, 40 * LAMPS)
    lamps = lamps[np.abs(lamps @ zenith) < np.sin(np.radians(5.0))]
    lamps = fisheye.pixels(lamps[fisheye.shows(lamps)])[:LAMPS]
    lights = np.vstack([fisheye.pixels(moon[None])[fisheye.shows(moon[None])], lamps])
    rest = FALSE - len(lights)
    noise_px = rng.uniform(*NOISE_PX)
    own = fisheye.pixels(sensor[seen])
    uv = np.vstack([own + rng.normal(0, noise_px, own.shape), lights,
                    rng.uniform(0, [width - 1, height - 1], (rest, 2))])
    return FisheyeNight(
        fisheye.shape, spots(uv, np.concatenate([
            flux, bright * 10 ** rng.uniform(-0.8, 0.8, len(lights)),
            rng.choice(flux, rest) if len(flux) else rng.uniform(size=rest)]), noise_px),
        icrf[seen], own)


def draw_images_of_a_night(rng: np.random.Generator, projection: str, count: int
                           ) -> tuple[Fisheye, list[FisheyeNight]]:
    """
    Return a fisheye that sees the whole sky, and so many of its images of eight hours.

    Its radius differs from that of the projection as those of lenses do. The sky turns; clouds
    and haze change from image to image.
    """
    shape = height, width = SHAPES[rng.integers(2)]
    radial = PROJECTIONS[projection](rng)
    a, b, c = rng.normal(0, _DEVIATION, 3)
    horizon = radial(np.array(np.pi / 2))

    def real(theta: np.ndarray) -> np.ndarray:
        r = radial(theta) / horizon
        return radial(theta) * (1 + a * (r ** 3 - 1) + b * (r ** 2 - 1) + c * (r - 1))
    middle = np.array([width - 1, height - 1]) / 2
    focal_px = float(min(shape) / 2 * rng.uniform(0.9, 1.1) / horizon)
    fisheye = Fisheye(shape, real, np.pi / 2, focal_px,
                      middle + rng.uniform(-0.02, 0.02, 2) * min(shape))
    scene = draw_scene(rng, _NIGHT_TILT_DEG)._replace(magnitude=MAGNITUDE[1])
    images = []
    for hours in np.linspace(0, _NIGHT_HOURS, count):
        turn = quaternion_from_rotation_vector(
            np.array([0.0, 0.0, np.radians(_SKY_DEG_PER_HOUR * hours)]))
        images.append(draw_image(rng, fisheye, scene._replace(
            moon=-scene.zenith, attitude=multiply(turn, scene.attitude),
            clouds=random_directions(rng, int(rng.integers(_MOST_CLOUDS))),
            haze_rad=np.radians(rng.uniform(*_HAZE_DEG)))))
    return fisheye, images


def draw_cropped(rng: np.random.Generator) -> FisheyeNight:
    """Return what a part of an image of a random rectilinear lens sees of a random sky."""
    def draw() -> Camera:
        whole = np.array(_CROPPED_OF)
        focal_px = whole[0] / 2 / np.tan(np.radians(rng.uniform(*CROPPED_DEG)) / 2)
        width, height = size = (rng.uniform(*CROPPED, 2) * whole).astype(int)
        cx, cy = (whole - 1) / 2 - rng.uniform(size=2) * (whole - size)
        return Camera(int(width), int(height), focal_px, focal_px, cx, cy,
                      (rng.uniform(*CROPPED_K1), 0.0, 0.0, 0.0, 0.0))
    camera = unfolded(draw)
    q, onboard, centroids, hip = draw_stars(
        rng, camera, rng.uniform(*CROPPED_STARS), NOISE_PX, missing=_MISSING, false=_CROPPED_FALSE)
    direction = onboard.direction[onboard.index_of(hip[hip > 0])]
    return FisheyeNight((camera.height, camera.width), centroids, direction,
                        camera.project(rotate(conjugate(q), direction)))


SKIES: dict[str, Callable[[np.random.Generator], FisheyeNight]] = {
    **{name: partial(draw_night, projection=name) for name in PROJECTIONS},
    'cropped': draw_cropped}
"""What has an answer, by name."""


def random_directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return unit vectors (count, 3), uniform on the sphere."""
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def spots(uv: np.ndarray, flux: np.ndarray, sigma_px: float) -> Centroids:
    """Return spots (N, 2) px of fluxes (N,) as centroids, brightest first."""
    order = np.argsort(-flux)
    return Centroids(uv[order], flux[order], np.full(len(uv), 50.0), np.full(len(uv), sigma_px))


def draw_uniform(rng: np.random.Generator) -> FisheyeNight:
    """Return spots anywhere in an image."""
    shape = height, width = SHAPES[rng.integers(len(SHAPES))]
    return _no_stars(shape, rng.uniform(0, [width - 1, height - 1], (rng.integers(40, 200), 2)),
                     rng)


def draw_horizon(rng: np.random.Generator) -> FisheyeNight:
    """Return spots of which most are on a circle."""
    night = draw_uniform(rng)
    height, width = night.shape
    angle = rng.uniform(0, 2 * np.pi, 40)
    ring = ([width / 2, height / 2] + rng.normal(0.45 * min(night.shape), 8, (40, 1))
            * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return _no_stars(night.shape, np.vstack([ring, night.centroids.uv]), rng)


def draw_rows(rng: np.random.Generator) -> FisheyeNight:
    """Return spots of which many are in straight rows at equal distances, like lamps."""
    night = draw_uniform(rng)
    size = np.array(night.shape[::-1]) - 1
    rows = [rng.uniform(0, size) + np.arange(8)[:, None] * rng.uniform(-0.1, 0.1, 2) * min(size)
            for _ in range(6)]
    lamps = np.vstack(rows)
    return _no_stars(night.shape, np.vstack([lamps, night.centroids.uv]), rng)


def draw_mirrored(rng: np.random.Generator) -> FisheyeNight:
    """Return a night flipped from left to right."""
    night = draw_night(rng, list(PROJECTIONS)[rng.integers(len(PROJECTIONS))])
    return _no_stars(night.shape, [night.shape[1] - 1, 0] + night.centroids.uv * [-1, 1], rng,
                     night.centroids.flux)


def draw_shuffled(rng: np.random.Generator) -> FisheyeNight:
    """Return a night with columns and rows of different spots."""
    night = draw_night(rng, list(PROJECTIONS)[rng.integers(len(PROJECTIONS))])
    u, v = night.centroids.uv.T
    return _no_stars(night.shape, np.column_stack([u, rng.permutation(v)]), rng,
                     night.centroids.flux)


NO_SKIES: dict[str, Callable[[np.random.Generator], FisheyeNight]] = {
    'uniform': draw_uniform, 'horizon': draw_horizon, 'rows': draw_rows,
    'mirrored': draw_mirrored, 'shuffled': draw_shuffled}
"""What has no answer, by name."""

CAMERA = 'camera'
KINDS = (*SKIES, *NO_SKIES, CAMERA)
"""Names of all draws."""


def _no_stars(shape: tuple[int, int], uv: np.ndarray, rng: np.random.Generator,
              flux: np.ndarray | None = None) -> FisheyeNight:
    inside = ((uv > 0) & (uv < np.array(shape[::-1]) - 1)).all(1)
    flux = 10 ** rng.uniform(2, 4, len(uv)) if flux is None else flux
    return FisheyeNight(shape, spots(uv[inside], flux[inside], rng.uniform(*NOISE_PX)),
                        np.empty((0, 3)), np.empty((0, 2)))


@dataclass(frozen=True)
class NightOutcome:
    """Whether each night (N,) is solved correctly or wrongly, and the processor time."""

    correct: np.ndarray
    wrong: np.ndarray
    cpu_s: np.ndarray


def solve_nights(name: str, trials: int, seed: int) -> NightOutcome:
    """Search so many nights, or lists without a sky, by name."""
    solver, draw = PhotographSolver(EPOCH_YEAR), {**SKIES, **NO_SKIES}[name]
    rng, rows = np.random.default_rng(seed), []
    # Databases are built at the first search ever.
    first = draw(np.random.default_rng(0))
    solver.solve_lists([first.centroids], first.shape)
    for _ in range(trials):
        night = draw(rng)
        start_s = time.process_time()
        sky = solver.solve_lists([night.centroids], night.shape).sky
        cpu_s = time.process_time() - start_s
        correct = sky is not None and len(night.uv) > 0 and night.error_px(sky) < _CORRECT_PX
        rows.append((correct, sky is not None and not correct, cpu_s))
    return NightOutcome(*(np.array(column) for column in zip(*rows)))


@dataclass(frozen=True)
class CameraOutcome:
    """
    The horizons of solved images (N,) of all-sky cameras.

    Relative radii, from the truth and from the mean of the camera.
    """

    off: np.ndarray
    from_mean: np.ndarray


def horizon_px(camera: Camera) -> float:
    """Return how far the horizon is from the axis, where the lens folds its last pixel."""
    angle = min(np.pi / 2, camera.farthest_rad)
    u, v = camera.project(np.array([np.sin(angle), 0.0, np.cos(angle)]))
    return float(np.hypot(u - camera.cx, v - camera.cy))


def follow_camera(trials: int, seed: int) -> CameraOutcome:
    """Solve so many images of one night of an all-sky camera."""
    rng, solver = np.random.default_rng(seed), PhotographSolver(EPOCH_YEAR)
    projection = list(PROJECTIONS)[rng.integers(len(PROJECTIONS) - 1)]
    fisheye, images = draw_images_of_a_night(rng, projection, trials)
    solutions = [solver.solve_lists([night.centroids], night.shape) for night in images]
    found = np.array([horizon_px(solution.camera) for solution in solutions
                      if solution.solved and solution.camera.model.equidistant])
    off = found / fisheye.radius_px(np.array(np.pi / 2)) - 1
    return CameraOutcome(off, off - off.mean() if len(off) else off)


def run_fisheyes_campaign(*, trials: int, seed: int, only: tuple[str, ...] = (),
                          scheduler: str = '') -> Result:
    """Run the draws of each kind and count."""
    names = tuple(dict.fromkeys(only or KINDS))
    lists = [name for name in names if name != CAMERA]
    outcomes = dict(zip(lists, parallel_trials(
        solve_nights, [(name,) for name in lists], trials, _PART_TRIALS, seed, title='fisheyes',
        scheduler=scheduler)))
    of_skies = [name for name in names if name in SKIES]
    rows = []
    if of_skies:
        nights = joined([outcomes[name] for name in of_skies])
        rows += [Row('solved', 100 * float(np.mean(nights.correct)), '%', least=99),
                 *(Row(f'solved, {name}', 100 * float(np.mean(outcomes[name].correct)), '%')
                   for name in of_skies),
                 Row('wrong', int(np.sum(nights.wrong)), 'nights', exactly=0),
                 Row('time, median', float(np.median(nights.cpu_s)), 's'),
                 Row('time, longest', float(np.max(nights.cpu_s)), 's', most=_TIME_S)]
    rows += [Row(f'accepted, {name}', int(np.sum(outcomes[name].wrong)), 'lists', exactly=0)
             for name in names if name in NO_SKIES]
    if CAMERA in names:
        camera, = parallel_trials(follow_camera, [()], trials, _PART_TRIALS, seed,
                                  title='all-sky cameras', scheduler=scheduler)
        rows += [
            Row('horizon, rms of a night', 100 * float(np.sqrt(np.mean(camera.from_mean ** 2))),
                '%', most=_SCATTER_PERCENT),
            Row('horizon, largest error', 100 * float(np.max(np.abs(camera.off))), '%')]
    return Result('campaign fisheyes', rows, {
        'machine': machine(),
        'lens': f'{FOV_DEG[0]:g} to {FOV_DEG[1]:g} deg, axis off by up to {CENTRE:.0%} of the '
                f'short side, up to {TILT_DEG:g} deg from the zenith',
        'cropped': f'{CROPPED[0]:.0%} to {CROPPED[1]:.0%} of each side of an image of '
                   f'{CROPPED_DEG[0]:g} to {CROPPED_DEG[1]:g} deg, k1 {CROPPED_K1[0]:g} to '
                   f'{CROPPED_K1[1]:g}, {CROPPED_STARS[0]} to {CROPPED_STARS[1]} stars on '
                   f'average, {_CROPPED_FALSE} false',
        'spots': f'stars to V {MAGNITUDE[0]:g} to {MAGNITUDE[1]:g}, noise {NOISE_PX[0]:g} to '
                 f'{NOISE_PX[1]:g} px, {FALSE} false: the Moon, up to {LAMPS} lamps, the rest '
                 'anywhere',
        'horizon': f'radius, images of {_NIGHT_HOURS:g} h of all-sky cameras, {_PART_TRIALS} of '
                   f'each, clouds and haze up to {_HAZE_DEG[0]:g} to {_HAZE_DEG[1]:g} deg',
        'given': 'nothing',
        'wrong': f'stars off by more than {_CORRECT_PX:g} px, median',
        'accepted': 'any answer to spots that are not sky',
        'times': 'process CPU time of all searches, with the databases there',
        'trials': trials, 'seed': seed})
