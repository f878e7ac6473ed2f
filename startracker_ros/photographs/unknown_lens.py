# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of an image of a wide lens of which nothing is known, its centre neither.

Such a lens is a fisheye, or a rectilinear one whose image is cropped or strongly distorted. The
projections of lenses differ little near the axis: an assumed one, of about the focal
length, has the shapes of small quads of stars (sky_quads.py) nearly right. One after the other is
assumed. A quad of neighbouring spots that has the shape of a quad of the sky is a candidate, and
the lens is grown from its four stars (native/src/blind/lens_growth.h): attitude, focal lengths,
principal point and radial terms. The most probable one of all assumed lenses is taken.

Of T candidates tested so far, each has T times the probability of a single one that its matches
are chance. The limit is so low that it adds nothing to the false alarms of other searches: a wide
lens sees dozens of bright stars.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, lru_cache
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.core.camera.distortion import EQUIDISTANT, PLUMB_BOB
from startracker_ros.core.camera.model import (
    Camera, CameraError, native_camera, project, unproject)
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.cache import cached_brightest
from startracker_ros.core.identify.identification import Identification, per_centroid
from startracker_ros.core.stored_arrays import prepare
from startracker_ros.photographs.ladder import Attempt, REFERENCE_YEAR
from startracker_ros.photographs.lens_fit import camera_of, FISHEYE_TERMS, SkyAndSpots
from startracker_ros.photographs.sky_quads import in_order, matching_neighbours, SkyQuads


class Lenses(NamedTuple):
    """
    Lenses of a kind that are assumed.

    radial are k1 to k4 of each fisheye; the longest side of the image has least_span focal lengths
    at least, the shortest side most_span at most. free (P,) are the prior standard deviations of
    attitude, focal length, pixel ratio, principal point and the terms from k1 on.
    """

    model: str
    radial: tuple[tuple[float, ...], ...]
    least_span: float
    most_span: float
    free: np.ndarray


# theta_d / theta of the projections as a series in theta^2, theta_d the radius over the focal
# length: 2 tan(theta / 2), theta, 2 sin(theta / 2) and sin(theta). From part of a circle to a
# circle with a margin.
FISHEYES = Lenses(
    EQUIDISTANT,
    ((1 / 12, 1 / 120, 17 / 20160, 31 / 362880), (0.0, 0.0, 0.0, 0.0),
     (-1 / 24, 1 / 1920, -1 / 322560, 1 / 92897280),
     (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880)),
    1.3, 5.2, np.array([10.0, 10.0, 10.0, 0.1, 0.02, 0.06, 0.06, *FISHEYE_TERMS]))
# Of 28 to some 100 deg and cropped, so that the axis may be anywhere. Narrower ones are found
# without their distortion.
RECTILINEAR = Lenses(PLUMB_BOB, ((),), 0.5, 1.7,
                     np.array([10.0, 10.0, 10.0, 0.1, 0.02, 0.25, 0.25, 0.25, 0.1]))
_STEP = 1.15  # from one focal length to the next
_LISTS, _SPOTS, _NEIGHBOURS = 3, 60, 7
_TOLERANCE, _RATIO = 0.012, 1.15  # of codes; of the focal length that a quad shows
_MOST_CANDIDATES = 20_000
_CERTAIN, _BEST = 1e-9, 3
# Rms of the residuals of the right lens, as a share of the long side and in px: one that has grown
# into a part of the image only, with another projection, fits worse.
_MOST_RESIDUAL, _LEAST_RESIDUAL_PX = 0.002, 3.0
_MAGNITUDE_LIMIT = 5.5
_STARS_PER_SPOT, _FEWEST_STARS = 2.0, 300
_SKY = 2000  # directions by which the share of the sky in an image is measured
_BELOW_HORIZON = -0.1


class UnknownLensIdentifier:
    """Identifies images of unknown wide lenses at one epoch."""

    def __init__(self, epoch_year: float, wide_quads: Callable[[], tuple[StarCatalog, SkyQuads]]
                 ) -> None:
        """wide_quads returns the quads, and the catalogue of their stars, when they are needed."""
        self._years = epoch_year - REFERENCE_YEAR
        self._wide_quads = wide_quads

    @cached_property
    def onboard(self) -> OnboardCatalog:
        """Return the stars of the images of a fisheye."""
        # What such a camera resolves.
        camera = Camera.from_fov(1500, 1500, 150.0, EQUIDISTANT)
        return cached_brightest(load_catalog(), camera, REFERENCE_YEAR, _MAGNITUDE_LIMIT)

    def identify_mirrored(self, lists: Iterable[Centroids], shape: tuple[int, int],
                          lenses: Lenses) -> Iterator[Attempt]:
        """Yield the results in the last of the lists, which are flipped from left to right."""
        yield from self.identify([*islice(lists, _LISTS)][-1:], shape, lenses)

    def identify(self, lists: Iterable[Centroids], shape: tuple[int, int], lenses: Lenses
                 ) -> Iterator[Attempt]:
        """Yield each identification of an image of shape (H, W) px by lenses of a kind."""
        catalog, sky = self._wide_quads()
        if self.onboard.stored is not None:
            prepare(sky.stored, self.onboard.stored)
        tested = 0
        for centroids in islice(lists, _LISTS):
            quads, uv = neighbours(centroids.uv[:_SPOTS]), centroids.uv[:_SPOTS]
            found = []
            for camera in _assumed(shape, lenses):
                spot, star, ratio, bright = self._candidates(catalog, sky, camera, uv, quads)
                tested += len(spot)
                # All of them count as tested.
                ordered = in_order(spot, star)
                spot, star, ratio = spot[ordered], star[ordered], ratio[ordered]
                if len(spot):
                    seen = SkyAndSpots(
                        self.onboard.direction[:bright], uv, centroids.sigma_px[:_SPOTS])
                    found.append(seen.grown(camera, lenses.free, spot, star, ratio))
            # The first one may have grown into a part of the image only.
            for lens, matched in sorted(found, key=lambda one: one[0]['probability'])[:_BEST]:
                false_alarm = float(lens['probability']) * tested
                attempt = (self._attempt(lens, lenses.model, matched, centroids, false_alarm)
                           if false_alarm < _CERTAIN else None)
                if attempt is not None:
                    yield attempt

    def _candidates(self, catalog: StarCatalog, sky: SkyQuads, camera: np.ndarray,
                    uv: np.ndarray, quads: np.ndarray
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """
        Return which spots (K, 4) of uv may be which stars (K, 4), and ratios of the sides (K,).

        The last one is the number of catalogue stars, the brightest ones, that the image may show.
        """
        spot, row, ratio = matching_neighbours(
            sky.table, unproject(camera, uv), quads, _TOLERANCE, 1 / _RATIO, _RATIO,
            _MOST_CANDIDATES)
        bright = min(max(int(_STARS_PER_SPOT * len(uv) / share_of_fisheye(camera)), _FEWEST_STARS),
                     len(self.onboard))
        star = self.onboard.index_of(catalog.hip[sky.table.star[row]])
        known = ((star >= 0) & (star < bright)).all(axis=1)
        return spot[known], star[known], ratio[known], bright

    def _attempt(self, lens: np.ndarray, model: str, matched: np.ndarray, centroids: Centroids,
                 false_alarm: float) -> Attempt | None:
        """Return the result of a grown lens, None where no camera has it or it fits badly."""
        row = np.flatnonzero(matched >= 0)
        try:
            camera = camera_of(lens, model)
            sensor = camera.unproject(centroids.uv[row])
            # The errors of stars at the edge of the image circle lead out of it.
            inside = np.isfinite(sensor).all(axis=1)
            attitude = estimate_attitude(
                sensor[inside], self.onboard.direction[matched[row[inside]]],
                np.maximum(centroids.sigma_px[row[inside]], 1.0) * camera.pixel_rad)
        except (CameraError, AttitudeError):
            return None
        residual_px = np.sqrt(np.mean(attitude.residual_rad ** 2)) / camera.pixel_rad
        if residual_px > max(_MOST_RESIDUAL * max(camera.width, camera.height),
                             _LEAST_RESIDUAL_PX):
            return None
        hip, magnitude, unknown = per_centroid(
            len(centroids), np.arange(len(matched)), matched, np.full(len(matched), np.nan),
            self.onboard.hip, self.onboard.magnitude)
        return Attempt(
            Identification('identified', f'{len(row)} stars', hip, magnitude, unknown,
                           attitude, 1.0, false_alarm),
            camera, self.onboard.after(self._years), centroids, camera)


def neighbours(uv: np.ndarray) -> np.ndarray:
    """Return quads (Q, 4), each once, of the spots uv (N, 2) with their nearest neighbours."""
    if len(uv) <= _NEIGHBOURS:
        return np.array(list(combinations(range(len(uv)), 4)), np.int64).reshape(-1, 4)
    nearest = np.linalg.norm(uv[:, None] - uv, axis=2).argsort(axis=1)[:, :_NEIGHBOURS + 1]
    others = np.array(list(combinations(range(1, _NEIGHBOURS + 1), 3)))
    quads = np.concatenate([np.broadcast_to(nearest[:, :1, None], (len(uv), len(others), 1)),
                            nearest[:, others]], axis=2).reshape(-1, 4)
    return np.unique(np.sort(quads, axis=1), axis=0)


def _assumed(shape: tuple[int, int], lenses: Lenses) -> Iterator[np.ndarray]:
    """Yield the st_camera of each assumed lens, its axis in the middle of an image (H, W) px."""
    height, width = shape
    longest, shortest = max(shape) / lenses.least_span, min(shape) / lenses.most_span
    steps = int(np.ceil(np.log(longest / shortest) / np.log(_STEP)))
    for focal_px in np.geomspace(longest, shortest, steps + 1).tolist():
        for terms in lenses.radial:
            yield native_camera((width, height), (focal_px, focal_px),
                                ((width - 1) / 2, (height - 1) / 2), terms, lenses.model)


def share_of_fisheye(camera: np.ndarray) -> float:
    """Return the share of the sky, above the horizon of a lens, that an image shows."""
    return _share_of(camera.tobytes())


# Of an image the lenses are the same for each of its lists.
@lru_cache(maxsize=256)
def _share_of(content: bytes) -> float:
    """Return the share of the sky of the st_camera of these bytes."""
    camera = np.frombuffer(content, native.CAMERA).reshape(())
    z = 1 - (2 * np.arange(_SKY) + 1) / _SKY
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(_SKY)
    direction = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn),
                          z], axis=1)[z > _BELOW_HORIZON]
    u, v = project(camera, direction).T
    seen = ((u > -0.5) & (u < camera['width_px'] - 0.5) & (v > -0.5)
            & (v < camera['height_px'] - 0.5))
    return max(int(np.count_nonzero(seen)), 1) / _SKY
