# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Lost-in-space identification by triangles and the stars that confirm them: Pyramid.

Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique,
Navigation 51 (2004). This is the method for general use, by the native library;
native/src/identify/search.h tells the steps.
"""

from copy import copy
from functools import cached_property, partial
from typing import Self

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.cache import cached_pairs
from startracker_ros.core.identify.identification import (
    Identification, IdentificationOptions, Identifier)
from startracker_ros.core.identify.pairs import MOST_PAIRS
from startracker_ros.core.identify.star_matcher import (
    BrightLevel, Found, native_patterns, Rules, StarMatcher)
from startracker_ros.core.stored_arrays import prepare

# The relative noise of shorter sides is too large to be of use.
_MIN_SEPARATION_PX = 20.0
# Of the very brightest stars: few pairs, all of them in the processor's cache.
_BRIGHT = BrightLevel(5.0, 4, 3)
# Of false_alarm_max, which several attempts share.
_LEAST_CHANCE = 1e-30


class PyramidIdentifier(Identifier):
    """Triangles of image stars, looked up side by side, confirmed by all other stars."""

    most_pairs = MOST_PAIRS

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        self.least_rad = _MIN_SEPARATION_PX * camera.pixel_rad
        self.most_rad = 2 * camera.corner_angle_rad * (1 + self.scale_error)
        self._cached_pairs = partial(
            cached_pairs, self.onboard, self.least_rad, self.most_rad, self.most_pairs)
        self.pairs = self._cached_pairs()
        self._set_bright(_BRIGHT)

    def _set_bright(self, bright: BrightLevel) -> None:
        """Search with all pairs and those of the brightest stars."""
        share = self.camera.fov_x_rad * self.camera.fov_y_rad / (4 * np.pi)
        self.bright_pairs = self._cached_pairs(
            brightest=int(np.ceil(bright.stars_per_field / share)))
        self._bright = bright
        self._stored = [made.stored for made in (self.onboard, self.pairs, self.bright_pairs)
                        if made.stored is not None]
        vars(self).pop('_matcher', None)

    @property
    def native_options(self) -> dict[str, float]:
        """Return fields of st_identification_options."""
        options = self.options
        return {'tolerance_sigmas': options.tolerance_sigmas,
                'sigma_floor_px': options.sigma_floor_px,
                'fov_error_percent': options.fov_error_percent,
                'false_alarm_max': max(options.false_alarm_max, _LEAST_CHANCE),
                'most_work_s': options.time_limit_s,
                'max_image_stars': options.max_image_stars}

    @property
    def _rules(self) -> Rules:
        return Rules(self.scale_error, lens_known=self.lens_known)

    def native_patterns(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return PATTERNS for a tracker that identifies as this does, and their arrays."""
        return native_patterns(
            self.onboard, self._rules, self.pairs, self.bright_pairs, self._bright)

    @cached_property
    def _matcher(self) -> StarMatcher:
        return StarMatcher(self.camera, self.onboard, self.native_options, self._rules,
                           self.pairs, self.bright_pairs, self._bright)

    def with_bright_level(self, bright: BrightLevel) -> Self:
        """Return an identifier of the same pairs with another level of the brightest stars."""
        other = copy(self)
        other._set_bright(bright)
        return other

    def with_camera(self, camera: Camera, options: IdentificationOptions) -> Self:
        """
        Return an identifier of another lens, floor, limit of chance or time, same database.

        The camera has about the same field of view and pixels.
        """
        other = copy(self)
        other.options, other.camera = options, camera
        for made in ('verifier', '_matcher'):
            vars(other).pop(made, None)
        return other

    def prepare(self) -> None:
        """Have the database in memory before a short search among many databases."""
        prepare(*self._stored)

    def identify(self, centroids: Centroids) -> Identification:
        """Return the stars of the first triangle that is verified."""
        return self.result_of(centroids, self._matcher.identify(centroids, self.until_s))

    def identify_within(self, centroids: Centroids, work_s: float) -> tuple[Identification, float]:
        """
        Return the stars of the first triangle that is verified by so much work, and what it took.

        Work is counted in the seconds that it is expected to take on a processor of 3 GHz, so
        that results are the same on all machines.
        """
        found = self._matcher.identify(centroids, work_s=work_s)
        return self.result_of(centroids, found), found.work_s

    def result_of(self, centroids: Centroids, found: Found) -> Identification:
        """Return what was found for centroids as the result."""
        if found.attitude is not None:
            return Identification('identified', f'{found.stars} stars', found.hip,
                                  found.magnitude, found.residual_px, found.attitude,
                                  found.focal_ratio, found.false_alarm)
        first, second = found.figures[:2]
        if found.status == 'too_few_stars':
            return self.too_few(centroids, int(first))
        if found.status == 'ambiguous':
            return self.unidentified(
                centroids, 'ambiguous', 'two attitudes fit the field '
                f'({first:.0f} and {second:.0f} stars)', found.false_alarm)
        if found.status == 'no_candidate':
            return self.no_candidate(centroids, int(first), found.tested, found.false_alarm)
        return self.time_limit(centroids, found.tested, found.false_alarm)
