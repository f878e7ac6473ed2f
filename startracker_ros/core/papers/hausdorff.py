# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Sets of bright stars around a pivot, looked up by the Hausdorff distance of their halves.

Zahednamazi, Toloei, Ghasemi (2023). Four bright stars around a pivot make two sets: the pivot
with the brightest, and the other three. The Hausdorff distance of the two, in the tangent plane
at the pivot, is the one number by which they are stored.

With noise one number does not identify five stars: some 65000 sets share 200 px. So here
it selects candidates. Three stars of a set must agree with the image in the sides of
their triangle; then the whole field verifies them.
"""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.identify.identification import (
    CandidateIdentifier, Candidates, FieldStars, IdentificationOptions)
from startracker_ros.core.maths.rotation import angle_between, unit_from_radec

# Pivots along one side of a square about the centre of an image, and the share of the radius of
# the circle from one to the next: 1 deg in a field of 12 deg.
_SIDE, _SPACING = 5, 1 / 6
_NEIGHBOURS = 6
BRIGHTEST_FOUR = ((0, 1, 2, 3),)
FOUR_OF_SIX = tuple(combinations(range(_NEIGHBOURS), 4))
"""Ranks in brightness of the four stars of a set."""

# In an image the second brightest may seem the brightest. The most probable sets come first: those
# that omit few brighter stars.
_IMAGE_FOURS = sorted([*FOUR_OF_SIX, *((b, a, c, d) for a, b, c, d in FOUR_OF_SIX)],
                      key=lambda four: (sum(four) + (four[0] > four[1]), four))
# A triangle flatter than this many sigmas of its corners predicts no other star.
_FLAT_SIGMAS = 4.0


@dataclass(frozen=True)
class Pivots:
    """Unit vectors (P, 3), and the star index (P,) of each; None where pivots are not stars."""

    direction: np.ndarray
    star: np.ndarray | None = None

    def first(self) -> 'Pivots':
        """Return the first pivot alone."""
        return Pivots(self.direction[:1], None if self.star is None else self.star[:1])


@dataclass(frozen=True)
class StarSets:
    """
    Sets of a pivot and four stars.

    feature (S,) is the Hausdorff distance in focal lengths. stars (S, 4) are indices into the
    list of stars: the brightest, the one at the Hausdorff distance, the other two with the one
    farther from the brightest first, so that the order of stars of nearly equal brightness does
    not depend on noise. A pivot that is a star comes before them (S, 5).
    """

    feature: np.ndarray
    stars: np.ndarray

    @classmethod
    def joined(cls, parts: list['StarSets']) -> 'StarSets':
        """Return the sets of all parts, sorted by feature."""
        feature = np.concatenate([part.feature for part in parts])
        order = np.argsort(feature, kind='stable')
        return cls(feature[order], np.concatenate([part.stars for part in parts])[order])


class HausdorffIdentifier(CandidateIdentifier):
    """
    Sets of the image, looked up among those of the sky.

    Neighbours of a pivot are the stars within a circle: unlike the field, it contains the same
    stars at every roll. The paper's circle, of radius_rad, is the largest about the centre of
    the image; a method may add wider ones, and sets without some of the brightest stars.
    """

    sky_fours: tuple[tuple[int, ...], ...] = BRIGHTEST_FOUR
    bases_by_brightness = True

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        half_px = np.array([camera.width, camera.height]) / 2
        self.centre_px = half_px - 0.5
        self.centre = camera.unproject(self.centre_px)
        edges = camera.unproject(self.centre_px + half_px * [[-1, 0], [1, 0], [0, -1], [0, 1]])
        self.radius_rad = float(angle_between(edges, self.centre).min())
        self.pivots = self.sky_pivots(self.onboard)
        direction = self.onboard.direction
        self._sky = StarSets.joined([
            star_sets(direction, self.pivots, around, four)
            for around in self._around(direction, self.pivots) for four in self.sky_fours])
        self._side = _sides(direction[self._sky.stars[:, :3]]).T

    @abstractmethod
    def sky_pivots(self, onboard: OnboardCatalog) -> Pivots:
        """Return the pivots of a sky with these stars."""

    @abstractmethod
    def image_pivots(self, field: FieldStars) -> Pivots:
        """Return the pivots of an image, the best one first."""

    @property
    def search_radii_rad(self) -> list[float]:
        """Radii of the circles that the neighbours of a pivot are in."""
        return [self.radius_rad]

    @property
    def pivot_error_rad(self) -> float:
        """Largest distance of a pivot of the image from the nearest one of the sky."""
        return 0.0

    @cached_property
    def published_sets(self) -> StarSets:
        """Return the sets of the paper's database."""
        return StarSets.joined([bright_sets(self.onboard.direction, self.pivots,
                                            self.radius_rad)])

    def nearest(self, field: FieldStars) -> Candidates | None:
        """
        Return the published set of the nearest feature, which is the result of the paper.

        None when fewer than four stars are around the first pivot of the image.
        """
        seen = bright_sets(field.direction, self.image_pivots(field).first(), self.radius_rad)
        sky = self.published_sets
        if not len(seen.feature) or not len(sky.feature):
            return None
        right = np.searchsorted(sky.feature, seen.feature[0])
        beside = np.clip([right - 1, right], 0, len(sky.feature) - 1)
        found = beside[np.abs(sky.feature[beside] - seen.feature[0]).argmin()]
        return Candidates(seen.stars[0], sky.stars[[found]])

    def candidates(self, field: FieldStars) -> Iterator[Candidates]:
        """Yield for each set of the image the stars of the sky that agree with it."""
        sigmas = self.options.tolerance_sigmas
        pivots = self.image_pivots(field)
        arounds = self._around(field.direction, pivots)
        for four, around in product(_IMAGE_FOURS, arounds):
            sets = star_sets(field.direction, pivots, around, four)
            base = sets.stars[:, :3]
            corner = field.direction[base]
            side = _sides(corner)
            sigma = np.sqrt(2) * field.sigma_rad[base].max(1)
            side_gate = sigmas * sigma[:, None] + self.scale_error * side
            gate = sigmas * sigma + self.scale_error * sets.feature + self.pivot_error_rad
            begin = np.searchsorted(self._sky.feature, sets.feature - gate, 'left')
            end = np.searchsorted(self._sky.feature, sets.feature + gate, 'right')
            flat = np.abs(np.linalg.det(corner)) < _FLAT_SIGMAS * sigma * side.max(1)
            for row in np.flatnonzero(~flat):
                agree = np.arange(begin[row], end[row])
                # Side after side: the first one leaves few.
                for known, seen, limit in zip(self._side, side[row], side_gate[row]):
                    agree = agree[np.abs(known[agree] - seen) <= limit]
                stars = self._sky.stars[agree, :3]
                yield Candidates(base[row], np.unique(stars, axis=0) if len(stars) else stars)

    def _around(self, direction: np.ndarray, pivots: Pivots) -> list[np.ndarray]:
        return [brightest_around(direction, pivots, radius_rad, _NEIGHBOURS)
                for radius_rad in self.search_radii_rad]


def brightest_around(direction: np.ndarray, pivots: Pivots, radius_rad: float,
                     count: int) -> np.ndarray:
    """
    Return the brightest stars (P, count) within a radius of each pivot, -1 for none.

    direction (N, 3) are those of the stars, brightest first. A pivot is not its own neighbour.
    """
    around = np.full((len(pivots.direction), count), -1)
    found = np.zeros(len(around), int)
    incomplete = len(around)
    # Imported here: a slow import that only this method needs.
    from scipy.spatial import cKDTree
    tree = cKDTree(pivots.direction)
    for star, vector in enumerate(direction):
        near = np.array(tree.query_ball_point(vector, 2 * np.sin(radius_rad / 2)), int)
        near = near[found[near] < count]
        if pivots.star is not None:
            near = near[pivots.star[near] != star]
        around[near, found[near]] = star
        found[near] += 1
        incomplete -= int(np.count_nonzero(found[near] == count))
        if not incomplete:
            break
    return around


def bright_sets(direction: np.ndarray, pivots: Pivots, radius_rad: float) -> StarSets:
    """Return the sets of the four brightest of stars (N, 3) around pivots, as published."""
    around = brightest_around(direction, pivots, radius_rad, 4)
    return star_sets(direction, pivots, around, *BRIGHTEST_FOUR)


def star_sets(direction: np.ndarray, pivots: Pivots, around: np.ndarray,
              four: tuple[int, ...]) -> StarSets:
    """
    Return the sets of stars (N, 3) of four ranks among those around (P, K) the pivots.

    The first of the four is used as the brightest. A pivot without four stars has no set.
    """
    stars = around[:, four]
    full = np.flatnonzero((stars >= 0).all(1))
    stars, pivot = stars[full], pivots.direction[full]
    tangent = direction[stars]
    tangent = tangent / (tangent @ pivot[:, :, None])
    first = np.stack([pivot, tangent[:, 0]], 1)
    distance = np.linalg.norm(first[:, :, None] - tangent[:, None, 1:], axis=-1)
    feature = hausdorff_distance(distance)
    # The star at the Hausdorff distance, then the others by their distance from the brightest.
    rank = np.where(np.any(distance == feature[:, None, None], axis=1), np.inf, distance[:, 1])
    others = np.take_along_axis(stars[:, 1:], np.argsort(-rank, axis=1, kind='stable'), 1)
    columns = [stars[:, 0], others]
    if pivots.star is not None:
        columns.insert(0, pivots.star[full])
    return StarSets(feature, np.column_stack(columns))


def hausdorff_distance(distance: np.ndarray) -> np.ndarray:
    """
    Return the Hausdorff distance (...) of sets A and B, from all distances (..., A, B).

    max(max_a min_b d(a, b), max_b min_a d(a, b)).
    """
    return np.maximum(distance.min(-1).max(-1), distance.min(-2).max(-1))


def _sides(corner: np.ndarray) -> np.ndarray:
    """Return the sides (T, 3) in rad of triangles (T, 3, 3)."""
    return angle_between(corner, corner[:, [1, 2, 0]])


class PivotIdentifier(HausdorffIdentifier):
    """
    The pivot approach: sets of a star and four of its brightest neighbours.

    The paper requires a star at the centre of the field. Here every star of the image is a pivot,
    the one nearest to the centre first. The image does not contain all neighbours of the outer
    ones: so sets without any two of the six brightest neighbours are stored, too, and again
    for the circle through the corners of the image, in which a sparse field has more stars.
    """

    min_stars = 5
    sky_fours = FOUR_OF_SIX

    @property
    def search_radii_rad(self) -> list[float]:
        return [self.radius_rad, max(self.camera.corner_angle_rad, self.radius_rad)]

    def sky_pivots(self, onboard: OnboardCatalog) -> Pivots:
        return Pivots(onboard.direction, np.arange(len(onboard)))

    def image_pivots(self, field: FieldStars) -> Pivots:
        order = np.argsort(-(field.direction @ self.centre), kind='stable')
        return Pivots(field.direction[order], order)


class SegmentIdentifier(HausdorffIdentifier):
    """
    The segmentation approach: sets of a virtual pivot and the four brightest stars around it.

    The nodes are at every degree of right ascension, 0 to 360, and of declination: 361 x 181.
    The first meridian and the poles are repeated, as in the published counts. A node is
    somewhere near the centre of an image, so the image pivots are that centre and points around
    it: some of them have the same neighbours as a node.
    """

    min_stars = 4

    @property
    def pivot_error_rad(self) -> float:
        """Half the diagonal between nodes; the tangent plane is stretched towards its edge."""
        return np.radians(1.0) / np.sqrt(2) / np.cos(self.radius_rad) ** 2

    def sky_pivots(self, onboard: OnboardCatalog) -> Pivots:
        ra_deg, dec_deg = np.meshgrid(np.arange(361.0), np.arange(-90.0, 91.0))
        return Pivots(unit_from_radec(np.radians(ra_deg.ravel()), np.radians(dec_deg.ravel())))

    def image_pivots(self, field: FieldStars) -> Pivots:
        step = np.tan(self.radius_rad) * _SPACING
        steps = np.stack(np.meshgrid(*[np.arange(_SIDE) - _SIDE // 2] * 2), -1).reshape(-1, 2)
        steps = steps[np.argsort(np.hypot(*steps.T), kind='stable')]
        focal_px = np.array([self.camera.fx, self.camera.fy])
        return Pivots(self.camera.unproject(self.centre_px + steps * step * focal_px))
