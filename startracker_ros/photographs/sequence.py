# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What solved images of a camera tell about its next one: lens, attitude, order of the pixels."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.earth import gcrs_from_itrf, in_range
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import conjugate, multiply, quaternion_from_matrix
from startracker_ros.io.images.images import Photograph
from startracker_ros.photographs.epoch_and_site import Epoch, OPTION
from startracker_ros.photographs.same_camera import Known
from startracker_ros.photographs.solution import Solution

# Images of more cameras in turn are rare.
_MOST_CAMERAS = 8
# So many images in a row with one lens are of one camera.
_CERTAIN = 10


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
        self._last[key] = [*before[-1:], _Solved(
            label, solution.camera, solution.quaternion, when, solution.photograph.mirrored,
            solution.photograph.bottom_up, alike)]
        if len(self._last) > _MOST_CAMERAS:
            del self._last[next(iter(self._last))]

    def knows(self, key: CameraKey) -> bool:
        """Return whether an image of a camera is solved."""
        return key in self._last

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
                     last.alike >= _CERTAIN and number.bit_count() > 1)


def camera_key(photograph: Photograph) -> CameraKey:
    """Return what the images of a camera have in common."""
    return photograph.image.shape, photograph.fov_deg
