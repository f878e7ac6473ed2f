# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What solved images of a camera tell about its next one.

That is its lens, its attitude, the order of its pixels, and which spots do not move with the
stars: hot pixels that compression or a mosaic has made as wide as a star.
"""

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.earth import gcrs_from_itrf, in_range
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.maths.rotation import conjugate, multiply, quaternion_from_matrix
from startracker_ros.io.images.images import Photograph
from startracker_ros.photographs.epoch_and_site import Epoch, OPTION
from startracker_ros.photographs.same_camera import Known
from startracker_ros.photographs.solution import Solution

# Images of more cameras in turn are rare.
_MOST_CAMERAS = 8
# So many images in a row with one lens are of one camera.
_CERTAIN = 10
# Solved images of a camera that show its fixed spots, and how far these are apart in two of them.
# What a pixel has seen of the sky is farther apart: otherwise the spot is a star.
_PATTERNS, _SAME_PX, _MOVED_PX = 4, 1.0, 5.0


CameraKey = tuple[object, ...]
"""What the images of a camera have in common."""


class _Solved(NamedTuple):
    """
    A solved image: its name, lens, attitude (4,), time, and the order of its pixels.

    alike is how many images in a row have been solved by the lens of the one before.
    """

    label: str
    camera: Camera
    quaternion: np.ndarray
    when: Epoch
    mirrored: bool
    bottom_up: bool
    alike: int


class _Pattern(NamedTuple):
    """Of a solved image: spots (N, 2) besides its known stars, and their directions (N, 3)."""

    uv: np.ndarray
    direction: np.ndarray


class ImageSequence:
    """
    The last images of each camera, as they are solved.

    A camera is known by the size of its images and the field of view that their files state. Once
    it is certain, other lenses are searched in the first, second, fourth, eighth ... image that is
    not solved: a cloudy night would take hours otherwise, a folder of several cameras does not
    get there.
    """

    def __init__(self) -> None:
        self._last: dict[CameraKey, list[_Solved]] = {}
        self._in_vain: Counter[CameraKey] = Counter()
        self._patterns: dict[CameraKey, list[_Pattern]] = {}

    def add(self, label: str, photograph: Photograph, when: Epoch, solution: Solution) -> None:
        """Note the solution of a photograph."""
        key = camera_key(photograph)
        if solution.quaternion is None or solution.photograph is None:
            self._in_vain[key] += 1
            return
        before = self._last.pop(key, [])
        alike = before[-1].alike + 1 if before and solution.lens_from else 0
        if not alike:
            del self._in_vain[key]
        patterns = self._patterns.setdefault(key, [])
        if len(patterns) < _PATTERNS:
            patterns.append(_pattern(solution.photograph.image, solution))
        self._last[key] = [*before[-1:], _Solved(
            label, solution.camera, solution.quaternion, when, solution.photograph.mirrored,
            solution.photograph.bottom_up, alike)]
        if len(self._last) > _MOST_CAMERAS:
            oldest = next(iter(self._last))
            del self._last[oldest]
            self._patterns.pop(oldest, None)

    def knows(self, key: CameraKey) -> bool:
        """Return whether an image of a camera is solved."""
        return key in self._last

    def learns(self, photograph: Photograph) -> bool:
        """Return whether the next images of a camera may tell more about a photograph of it."""
        return len(self._patterns.get(camera_key(photograph), ())) < _PATTERNS

    def ordered(self, photograph: Photograph) -> Photograph:
        """Return a photograph with the order of the pixels of the one before."""
        before = self._last.get(camera_key(photograph))
        if before and before[-1].mirrored != photograph.mirrored:
            photograph = photograph.mirror()
        if before and not photograph.order_known and (
                before[-1].bottom_up != photograph.bottom_up):
            photograph = photograph.turn_over()
        return photograph

    def known(self, photograph: Photograph, when: Epoch) -> Known | None:
        """Return what the images before tell about a photograph, None for nothing."""
        before = self._last.get(camera_key(photograph))
        if not before:
            return None
        last = before[-1]
        expected = [last.quaternion]
        if {when.known, last.when.known} == {True} and OPTION not in (
                when.source, last.when.source) and all(
                    in_range(year) for year in (when.year, last.when.year)):
            earth, earth_before = (quaternion_from_matrix(gcrs_from_itrf(year))
                                   for year in (when.year, last.when.year))
            expected.append(multiply(
                multiply(earth, conjugate(earth_before)), last.quaternion))
        if len(before) == 2:
            turn = multiply(last.quaternion, conjugate(before[0].quaternion))
            expected.append(multiply(turn, last.quaternion))
        number = self._in_vain[camera_key(photograph)] + 1
        return Known(last.camera, np.array(expected), last.label,
                     last.alike >= _CERTAIN and number.bit_count() > 1,
                     fixed=_fixed(self._patterns[camera_key(photograph)],
                                  _MOVED_PX * last.camera.pixel_rad))


def _pattern(image: np.ndarray, solution: Solution) -> _Pattern:
    """Return the spots of a solved image (H, W) that are not its stars."""
    assert solution.sky is not None
    uv = CentroidExtractor().find_highest_peaks(image).uv
    stars = solution.centroids.uv[solution.identification.hip > 0]
    apart = np.linalg.norm(uv[:, None] - stars, axis=2)
    uv = uv[apart.min(axis=1, initial=np.inf) > _MOVED_PX]
    return _Pattern(uv, solution.sky.directions(uv))


def _fixed(patterns: Sequence[_Pattern], moved_rad: float) -> np.ndarray:
    """Return the places (F, 2) of spots that two images have, of different parts of the sky."""
    places = [np.empty((0, 2))]
    for one, other in combinations(patterns, 2):
        i, j = np.nonzero(
            np.linalg.norm(one.uv[:, None] - other.uv, axis=2) < _SAME_PX)
        moved = np.linalg.norm(one.direction[i] - other.direction[j], axis=1) > moved_rad
        places.append(one.uv[i[moved]])
    return np.concatenate(places)


def camera_key(photograph: Photograph) -> CameraKey:
    """Return what the images of a camera have in common."""
    return photograph.image.shape, photograph.fov_deg
