# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Frames that the Hausdorff methods, the Pyramid and structures of five stars identify.

Zahednamazi, Toloei, Ghasemi 2023.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import build_onboard_catalog, onboard_catalog
from startracker_ros.core.catalog.stars import CATALOG_EPOCH_YEAR, load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list, synthetic_field
from startracker_ros.core.identify.hausdorff import bright_sets, HausdorffIdentifier, Pivots
from startracker_ros.core.identify.identification import (
    Candidates, FieldStars, IdentificationOptions)
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.pairs import build_pairs
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.maths.rotation import (
    quaternion_from_pointing, radec_from_unit, random_attitude, rotate)
from startracker_ros.evaluation.campaign.five_stars import FiveStarStructures
from startracker_ros.tools.figures.correctness import is_correct
from startracker_ros.tools.figures.timing import cpu_timed

CAMERA = Camera.from_fov(512, 512, 12.0)
EPOCH_YEAR = 2000.0
# All stars of an image: any of them may be the one at the centre.
_IMAGE_STARS = 100
_WARM_UP = 3
_FIVE_STAR_TOLERANCE_RAD = 1e-5

METHODS = 'as published', 'verified', 'pyramid'
"""The set at the nearest distance; the method of the node; the Pyramid on the same frames."""

SLOW_CELL = 4.0
"""The magnitude limit of figure 12, in the field of the five-star structures."""
SLOW_CAMERA = Camera.from_fov(512, 512, 20.0)


@dataclass(frozen=True)
class Frames:
    """
    Conditions of frames: Gaussian noise per axis and of the magnitudes, and where they look.

    at_pivot puts a pivot of the database at the centre of the field, as in the paper: a random
    star, or the node next to a random direction.
    """

    sigma_px: float
    sigma_mag: float
    at_pivot: bool


FRAMES = {
    'no noise, at pivots': Frames(0.0, 0.0, True),
    '0.0005 px, at pivots': Frames(0.0005, 0.0, True),
    '0.1 px, at pivots': Frames(0.1, 0.1, True),
    '0.1 px, anywhere': Frames(0.1, 0.1, False),
}


@dataclass(frozen=True)
class Outcomes:
    """Results of F directions; stars (F,) counts those in the image, the rest (F, M) METHODS."""

    stars: np.ndarray
    solved: np.ndarray
    correct: np.ndarray
    time_ms: np.ndarray

    def shares(self, method: str) -> tuple[float, float, float]:
        """Return the shares of none, correct and wrong in %."""
        column = METHODS.index(method)
        solved, correct = self.solved[:, column], self.correct[:, column]
        none, right = 100 * float(np.mean(~solved)), 100 * float(np.mean(correct))
        return none, right, 100 * float(np.mean(solved & ~correct))

    def mean_ms(self, method: str) -> float:
        """Return the mean time of a direction."""
        return float(self.time_ms[:, METHODS.index(method)].mean())


@cache
def _identifier(method: str, magnitude_limit: float) -> HausdorffIdentifier:
    identifier = make_identifier(CAMERA, EPOCH_YEAR, _options(f'hausdorff_{method}',
                                                              magnitude_limit))
    assert isinstance(identifier, HausdorffIdentifier)
    return identifier


def _options(method: str, magnitude_limit: float) -> IdentificationOptions:
    return IdentificationOptions(method=method, magnitude_limit=magnitude_limit,
                                 max_image_stars=_IMAGE_STARS)


@cache
def _pyramid(camera: Camera, magnitude_limit: float) -> PyramidIdentifier:
    return PyramidIdentifier(camera, EPOCH_YEAR, _options('pyramid', magnitude_limit))


def directions(method: str, magnitude_limit: float, name: str, count: int,
               seed: int) -> Outcomes:
    """Return the outcomes of count random directions under the named conditions."""
    identifier, pyramid = _identifier(method, magnitude_limit), _pyramid(CAMERA, magnitude_limit)
    warm, rng = np.random.default_rng(0), np.random.default_rng(seed)
    for _ in range(_WARM_UP):
        _direction(identifier, pyramid, FRAMES[name], warm)
    rows = [_direction(identifier, pyramid, FRAMES[name], rng) for _ in range(count)]
    return Outcomes(*(np.array(column) for column in zip(*rows)))


def _direction(identifier: HausdorffIdentifier, pyramid: PyramidIdentifier, frames: Frames,
               rng: np.random.Generator) -> tuple:
    """Return one row of Outcomes."""
    q = _attitude(identifier.pivots, rng) if frames.at_pivot else random_attitude(rng)
    centroids, hip = star_list(identifier.onboard, identifier.camera, q, frames.sigma_px, rng,
                               magnitude_sigma=frames.sigma_mag)
    cpu_s, (field, found) = cpu_timed(_nearest_set, identifier, centroids)
    solved = [found is not None]
    correct = [found is not None and np.array_equal(
        hip[field.index[found.base]], identifier.onboard.hip[found.stars[0]])]
    times_s = [cpu_s]
    for other in (identifier, pyramid):
        cpu_s, identified = cpu_timed(other.identify, centroids)
        attitude = identified.attitude
        solved.append(attitude is not None)
        correct.append(attitude is not None and is_correct(attitude.quaternion, q))
        times_s.append(cpu_s)
    return len(hip), solved, correct, [1e3 * time_s for time_s in times_s]


def _nearest_set(identifier: HausdorffIdentifier, centroids: Centroids
                 ) -> tuple[FieldStars, Candidates | None]:
    """Return the stars of the field and the set at the nearest distance, as in the paper."""
    field = identifier.field_stars(centroids)
    return field, identifier.nearest(field)


def _attitude(pivots: Pivots, rng: np.random.Generator) -> np.ndarray:
    """Return a quaternion with a pivot of the sky at the centre of the field, at any roll."""
    if pivots.star is None:
        index = np.argmax(pivots.direction @ rotate(random_attitude(rng), [0.0, 0.0, 1.0]))
    else:
        index = rng.integers(len(pivots.star))
    ra_rad, dec_rad = map(float, radec_from_unit(pivots.direction[index]))
    return quaternion_from_pointing(ra_rad, dec_rad, rng.uniform(0, 2 * np.pi))


def stored_sets(method: str, magnitude_limit: float) -> int:
    """Return the number of sets of the catalogue with unmerged doubles."""
    stars = build_onboard_catalog(load_catalog(), CATALOG_EPOCH_YEAR, merge_rad=0.0, crowd_rad=0.0,
                                  magnitude_limit=magnitude_limit)
    identifier = _identifier(method, magnitude_limit)
    return len(bright_sets(stars.direction, identifier.sky_pivots(stars),
                           identifier.radius_rad).feature)


def builds(magnitude_limit: float) -> dict[str, float]:
    """Return the process CPU time in s of building each database of the stars to a limit."""
    onboard = onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR, magnitude_limit)
    times_s = {'pyramid': cpu_timed(build_pairs, onboard, 0.0, 2 * CAMERA.corner_angle_rad)[0]}
    for method in ('pivot', 'segment'):
        identifier = _identifier(method, magnitude_limit)
        times_s[method] = cpu_timed(bright_sets, onboard.direction,
                                    identifier.sky_pivots(onboard), identifier.radius_rad)[0]
        times_s[f'{method}, verified'] = cpu_timed(
            type(identifier), CAMERA, EPOCH_YEAR, identifier.options)[0]
    return times_s


@dataclass(frozen=True)
class SlowPeer:
    """Mean times in ms, times to build in s and shares of fields solved in %, by method."""

    time_ms: dict[str, float]
    build_s: dict[str, float]
    solved: dict[str, float]


def five_star_frames(count: int, seed: int) -> SlowPeer:
    """Return figures of count fields of five bright stars or more, a star at their centres."""
    identifier = make_identifier(SLOW_CAMERA, EPOCH_YEAR, _options('hausdorff_pivot', SLOW_CELL))
    assert isinstance(identifier, HausdorffIdentifier)
    onboard, pyramid = identifier.onboard, _pyramid(SLOW_CAMERA, SLOW_CELL)
    diameter_rad = 2 * SLOW_CAMERA.corner_angle_rad
    build_s, structures = cpu_timed(FiveStarStructures, onboard.direction, diameter_rad)
    for other in (identifier, pyramid):
        other.warm_up()
    _nearest_set(identifier, synthetic_field(onboard, SLOW_CAMERA)[0])
    rng = np.random.default_rng(seed)
    times: dict[str, list[float]] = {'five stars': [], 'pivot': [], 'pyramid': []}
    solved: dict[str, list[bool]] = {name: [] for name in times}
    while len(times['pivot']) < count:
        centroids, hip = star_list(onboard, SLOW_CAMERA, _attitude(identifier.pivots, rng), 0.0,
                                   rng, magnitude_sigma=0.0)
        if len(hip) < identifier.min_stars:
            continue
        direction = SLOW_CAMERA.unproject(centroids.uv)
        cpu_s, star = cpu_timed(structures.identify, direction, _FIVE_STAR_TOLERANCE_RAD)
        times['five stars'].append(cpu_s)
        solved['five stars'].append(star is not None and np.array_equal(
            onboard.hip[star], hip[:len(star)]))
        cpu_s, (field, found) = cpu_timed(_nearest_set, identifier, centroids)
        times['pivot'].append(cpu_s)
        solved['pivot'].append(found is not None and np.array_equal(
            hip[field.index[found.base]], onboard.hip[found.stars[0]]))
        cpu_s, result = cpu_timed(pyramid.identify, centroids)
        times['pyramid'].append(cpu_s)
        solved['pyramid'].append(result.attitude is not None)
    return SlowPeer({name: 1e3 * float(np.mean(values)) for name, values in times.items()},
                    {'five stars': build_s,
                     'pivot': cpu_timed(bright_sets, onboard.direction, identifier.pivots,
                                        identifier.radius_rad)[0],
                     'pyramid': cpu_timed(build_pairs, onboard, 0.0, diameter_rad)[0]},
                    {name: 100 * float(np.mean(values)) for name, values in solved.items()})
