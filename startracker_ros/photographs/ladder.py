# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of images of an uncalibrated camera: one lens model after the other.

Each step is an identification with an error of the lens (sigma_floor_px), a ratio of the pixel
sides and a radial distortion. The first ones solve most images: an ideal lens with an error of a
pixel. The last ones allow for stars far from where an ideal lens has them. A step accepts a
candidate when its false-alarm probability is below false_alarm_max over the number of attempts, so
that all together are as strict as one identification. The lens is then fitted (estimated_lens.py),
so near misses reject nothing here.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from itertools import islice, product
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.star_matcher import BrightLevel
from startracker_ros.core.stored_arrays import prepare
from startracker_ros.photographs.detections import FEW_LISTS, few_star_lists, LISTS
from startracker_ros.photographs.few_stars import few_stars, image_area
from startracker_ros.photographs.sky_triangles import sky_triangles, SkyTriangles


REFERENCE_YEAR = 2015.0
"""
Epoch of the databases of uncalibrated cameras, one set for all images.

Proper motion since then is far below the tolerances of a search; the lens is fitted to stars
that have moved.
"""


class Step(NamedTuple):
    """
    A lens model: error, fy / fx, k1.

    Where bright, many triangles of the brightest stars are tried first. That is fast in deep
    images, whose wide tolerances fit many catalogue stars, and in vain where few spots are stars.
    """

    sigma_floor_px: float
    pixel_ratio: float = 1.0
    k1: float = 0.0
    bright: bool = False


STEPS = (
    Step(1.0), Step(1.0, bright=True), Step(2.0), Step(0.2), Step(0.5), Step(4.0),
    Step(1.0, pixel_ratio=0.5), Step(1.0, pixel_ratio=2.0), Step(2.0, k1=-0.2),
    Step(2.0, pixel_ratio=0.935), Step(2.0, pixel_ratio=1.07), Step(4.0, k1=0.15),
    Step(4.0, k1=-0.35), Step(4.0, pixel_ratio=1.07, k1=-0.2),
    Step(4.0, pixel_ratio=0.935, k1=-0.2))
# Times are those of identify_within(). A search that succeeds mostly does so in a millisecond.
_PASSES_S = (0.001, 0.004, 0.02, 0.1)
_LONGEST_S = 0.6  # of all searches, so that an image without stars is soon left
_BRIGHT = BrightLevel(stars_per_field=10.0, image_stars=10, triangles=60)
# Mirrored images are named as such: the first steps, each list of stars once.
_MIRRORED_STEPS, _MIRRORED_S = STEPS[:4], 0.004
# No chip is as long: such an image has every other row, or binned ones, or is cropped.
_LONG, _CHIP = 2.0, 4 / 3
ATTEMPTS = 2 * LISTS * (len(STEPS) + 1 + len(_MIRRORED_STEPS))
"""
Twice the identifications of one image at most, each of which may be wrong by chance.

Twice, because the search for few stars may be wrong as often as all of them.
"""
# Each list is searched so long for few stars, with this error of the lens.
_FEW_S, _FEW_FLOOR_PX = 0.15, 0.3
# Images so wide, an ideal lens with fewer triangles than memory has room for.
_FEW_DEG = 4.0, 30.0


def chip_ratio(width: int, height: int) -> float | None:
    """Return the pixel ratio of an image too long for a chip, if that has 4 : 3; else None."""
    aspect = width / height
    return _CHIP / aspect if not 1 / _LONG < aspect < _LONG else None


class UncalibratedPyramid(PyramidIdentifier):
    """The pyramid method without the test for near misses, and a database that is soon built."""

    # The brightest stars of an image may be saturated, or not be stars.
    stars_per_field = 45.0
    lens_known = False
    most_pairs = 2e6


class Attempt(NamedTuple):
    """A result, its lens, catalogue of the epoch and centroids, and the nominal camera."""

    identification: Identification
    camera: Camera
    onboard: OnboardCatalog
    centroids: Centroids
    nominal: Camera


class LadderIdentifier:
    """Identifies images of one uncalibrated camera at one epoch."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions()) -> None:
        """Make what is searched; the database is built, or loaded, when it is first used."""
        self.camera = camera
        self._years = epoch_year - REFERENCE_YEAR
        self._options = replace(options, false_alarm_max=options.false_alarm_max / ATTEMPTS)
        self._steps: dict[Step, PyramidIdentifier] = {}
        self._triangles: SkyTriangles | None = None
        ratio = chip_ratio(camera.width, camera.height)
        self._chance = options.false_alarm_max
        fov_deg = np.degrees(max(camera.fov_x_rad, camera.fov_y_rad))
        self._seeks_few = not camera.model.equidistant and _FEW_DEG[0] <= fov_deg <= _FEW_DEG[1]
        self._order = STEPS if ratio is None else (
            STEPS[0], Step(1.0, pixel_ratio=ratio, bright=True), *STEPS[1:])

    def identify(self, lists: Iterable[Centroids]) -> Iterator[Attempt]:
        """
        Yield the result of each step with each of the lists of centroids of one image.

        Searches that were interrupted are repeated with more work, until that of time_limit_s or
        _LONGEST_S is done. The first pass is of the first two lists.
        """
        left_s = min(self._options.time_limit_s, _LONGEST_S)
        # A list is made when it is first used: most images need only the first one.
        searches: Iterable[tuple[Step, Centroids]] = (
            (step, centroids) for step in self._order for centroids in islice(lists, 2))
        for number, work_s in enumerate(_PASSES_S):
            waiting = []
            for step, centroids in searches:
                if left_s < work_s:
                    return
                attempt, spent_s = self._search(step, centroids, work_s)
                left_s -= spent_s
                if attempt is not None:
                    yield attempt
                    if attempt.identification.status == 'time_limit':
                        waiting.append((step, centroids))
            if not number:
                for centroids in few_star_lists(lists) if self._seeks_few else ():
                    attempt, spent_s = self._few(centroids, self._database, 0.5)
                    left_s -= spent_s
                    yield attempt
                waiting += product(self._order, islice(lists, 2, None))
            searches = waiting

    def identify_few(self, lists: Iterable[Centroids], camera: Camera, error: float,
                     share: float) -> Iterator[Attempt]:
        """
        Yield the results of the search for few stars by a lens that is known to error.

        share is that of false_alarm_max.
        """
        if not self._seeks_few or camera.model.equidistant:
            return
        identifier = self._database.with_camera(
            camera, replace(self._options, fov_error_percent=100 * error))
        for centroids in few_star_lists(lists):
            yield self._few(centroids, identifier, share)[0]

    def identify_mirrored(self, lists: Iterable[Centroids]) -> Iterator[Attempt]:
        """Yield the results of a quick search in lists that are flipped from left to right."""
        for step, centroids in product(_MIRRORED_STEPS, lists):
            attempt, _ = self._search(step, centroids, _MIRRORED_S)
            if attempt is not None:
                yield attempt

    def _few(self, centroids: Centroids, identifier: PyramidIdentifier, share: float
             ) -> tuple[Attempt, float]:
        """Return the result of the search for few stars, and its work in s."""
        if self._triangles is None:
            self._triangles = sky_triangles(self._database.onboard, image_area(self.camera))
        prepare(self._triangles.stored)
        found, spent_s = few_stars(identifier, self._triangles.table, centroids, _FEW_FLOOR_PX,
                                   share * self._chance / FEW_LISTS, _FEW_S)
        return self._attempt(found, identifier, centroids), spent_s

    def _search(self, step: Step, centroids: Centroids, work_s: float
                ) -> tuple[Attempt | None, float]:
        """Return the result of a search of limited work, and its work in s."""
        identifier = self._identifier(step)
        if identifier is None:
            return None, 0.0
        identifier.prepare()
        found, spent_s = identifier.identify_within(centroids, work_s)
        return self._attempt(found, identifier, centroids), spent_s

    def _attempt(self, found: Identification, identifier: PyramidIdentifier,
                 centroids: Centroids) -> Attempt:
        onboard = identifier.onboard if found.attitude is None else self._moved
        return Attempt(found, identifier.camera, onboard, centroids, self.camera)

    def _identifier(self, step: Step) -> PyramidIdentifier | None:
        """Return the identifier of a step, None for a lens that folds the image."""
        if step not in self._steps:
            camera = self._camera(step)
            if camera is None:
                return None
            options = replace(self._options, sigma_floor_px=step.sigma_floor_px)
            database = self._database
            if step.bright:
                database = database.with_bright_level(_BRIGHT)
            self._steps[step] = database.with_camera(camera, options)
        return self._steps[step]

    @cached_property
    def _database(self) -> PyramidIdentifier:
        return UncalibratedPyramid(self.camera, REFERENCE_YEAR, self._options)

    @cached_property
    def _moved(self) -> OnboardCatalog:
        """Return the stars at the epoch of the images."""
        return self._database.onboard.after(self._years)

    def _camera(self, step: Step) -> Camera | None:
        """Return the camera with pixel ratio and distortion of a step, of the same width."""
        camera = self.camera
        # Of the edge of the image in undistorted coordinates, with this distortion.
        edge = 1 + step.k1 * camera.radius(camera.fov_x_rad / 2) ** 2
        if edge <= 0:
            return None
        try:
            return replace(camera, fx=camera.fx / edge, fy=camera.fy / edge * step.pixel_ratio,
                           distortion=(camera.distortion[0] + step.k1, *camera.distortion[1:]))
        except CameraError:
            return None
