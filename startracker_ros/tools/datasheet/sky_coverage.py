# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How many stars each field of the sky has, and how many fields are identified at once."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import Identifier
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import (
    conjugate, pointing_from_quaternion, random_attitude, rotate)
from startracker_ros.tools.datasheet.instrument import EPOCH_YEAR
from startracker_ros.tools.figures.correctness import is_correct
from startracker_ros.tools.figures.timing import cpu_timed

_MISSING, _FALSE = 0.05, 2
_MAX_STARS = 40


@dataclass(frozen=True)
class SkyFields:
    """
    Random fields (N,): boresight in rad, and what identification makes of a list of their stars.

    stars is the number of stars up to the limiting magnitude; correct and wrong are of the
    attitude, with neither where none was accepted; time_ms is processor time.
    """

    ra_rad: np.ndarray
    dec_rad: np.ndarray
    stars: np.ndarray
    correct: np.ndarray
    wrong: np.ndarray
    time_ms: np.ndarray


def field_magnitudes(camera: Camera, limit: float, fields: int, seed: int) -> list[np.ndarray]:
    """Return the magnitudes, ascending, of the stars up to a limit in random fields."""
    onboard = onboard_catalog(camera_catalog(camera), camera, EPOCH_YEAR, limit)
    if not len(onboard):
        return [np.empty(0)] * fields
    rng = np.random.default_rng(seed)
    q = [random_attitude(rng) for _ in range(fields)]
    boresight = np.array([rotate(each, [0.0, 0.0, 1.0]) for each in q])
    radius = 2 * np.sin(min(camera.corner_angle_rad, np.pi / 2) / 2)
    near = cKDTree(onboard.direction).query_ball_point(boresight, radius)
    return [_magnitudes(camera, onboard, each, np.array(sorted(stars), int))
            for each, stars in zip(q, near)]


def _magnitudes(camera: Camera, onboard: OnboardCatalog, q: np.ndarray, near: np.ndarray
                ) -> np.ndarray:
    """Return the magnitudes of those stars, in their order, that are in the image."""
    uv = camera.project(rotate(conjugate(q), onboard.direction[near]))
    return onboard.magnitude[near][camera.contains(uv)]


def star_counts(magnitudes: list[np.ndarray], limit: float) -> np.ndarray:
    """Return the number of stars up to a limiting magnitude in each field (N,)."""
    return np.array([np.searchsorted(each, limit, side='right') for each in magnitudes])


@cache
def _identifier(camera: Camera, limit: float) -> tuple[Identifier, OnboardCatalog]:
    return (make_identifier(camera, EPOCH_YEAR),
            onboard_catalog(camera_catalog(camera), camera, EPOCH_YEAR, limit))


def identified_fields(camera: Camera, limit: float, sigma_px: float, fields: int, seed: int
                      ) -> SkyFields:
    """Identify lists of the stars of random fields up to a limit, with errors of sigma_px."""
    rng = np.random.default_rng(seed)
    identifier, onboard = _identifier(camera, limit)
    rows = []
    for _ in range(fields):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, camera, q, sigma_px, rng, missing=_MISSING,
                                   false=_FALSE)
        spent_s, found = cpu_timed(identifier.identify, centroids.select(slice(_MAX_STARS)))
        solved = found.attitude is not None
        correct = found.attitude is not None and is_correct(found.attitude.quaternion, q)
        ra_rad, dec_rad, _ = pointing_from_quaternion(q)
        rows.append((ra_rad, dec_rad, np.count_nonzero(hip), correct, solved and not correct,
                     1e3 * spent_s))
    return SkyFields(*map(np.array, zip(*rows)))
