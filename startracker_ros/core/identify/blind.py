# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of an image of unknown scale: one nominal field of view after the other.

The fields are geometric steps of the long side of the image, 1 to 120 deg, that the tolerance of
the focal length covers without a gap. Those close to the likely field come first, with a
millisecond each, then all of them with more; the time of all together is limited. A candidate is
accepted when its false-alarm probability is below false_alarm_max over the number of all
searches.

The databases do not depend on the image: two fields share one, whatever the number and shape of
the pixels, and the disk cache has it for the next process.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, islice, product
import time

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog, load_deep_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.ladder import Attempt, Step, UncalibratedPyramid

FOV_ERROR = 0.05
"""Tolerance of the focal length of each field."""

_LOWEST_DEG, _HIGHEST_DEG = 1.0, 120.0
LIKELY_DEG = 25.0
"""The middle of the fields of most photographs, 10 to 60 deg, by ratio."""

_LIKELY_FIELDS = 29  # some 6 to 80 deg: these first, with further lens models
_LISTS = 2
_STEP = 1.0 + 2 * FOV_ERROR
_FIELDS_PER_DATABASE = 2
# What the images of a database are like; other shapes see some more or fewer of its stars.
_WIDTH, _HEIGHT = 1024, 768
COARSEST_PIXEL_DEG = 0.3
"""Larger pixels resolve no stars."""

_STEPS = (Step(1.0), Step(1.0, pixel_ratio=0.5), Step(0.2), Step(1.0, pixel_ratio=2.0))
# A search that succeeds mostly does so within a millisecond or two.
_PASSES_S, _TIME_LIMIT_S, _MIRRORED_LIMIT_S = (0.0015, 0.004), 2.0, 0.6


def _half_tangents() -> np.ndarray:
    """Return the tangents (F,) of half the long side of each field."""
    low, high = np.tan(np.radians([_LOWEST_DEG, _HIGHEST_DEG]) / 2)
    return np.geomspace(low, high, int(np.ceil(np.log(high / low) / np.log(_STEP))) + 1)


_TANGENTS = _half_tangents()
# Mirrored images are named as such: the first step alone.
ATTEMPTS = _LISTS * (len(_STEPS) + 1) * len(_TANGENTS)
"""Identifications of one image at most, each of which may be wrong by chance."""


class _BlindPyramid(UncalibratedPyramid):
    """The pyramid method for deeper images than the automatic limit, and a small database."""

    stars_per_field = 30.0
    most_pairs = 1e6


class BlindIdentifier:
    """Identifies images of cameras of any field of view at one epoch."""

    def __init__(self, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions()) -> None:
        """Databases are built when their field is first searched."""
        self._epoch_year = epoch_year
        self._options = replace(options, fov_error_percent=100 * FOV_ERROR,
                                time_limit_s=_PASSES_S[-1],
                                false_alarm_max=options.false_alarm_max / ATTEMPTS)
        self._deep = cache(load_deep_catalog)
        self._databases: dict[int, _BlindPyramid] = {}
        self._shape = (0, 0)
        self._identifiers: dict[tuple[int, Step], _BlindPyramid] = {}

    def identify(self, lists: Iterable[Centroids], shape: tuple[int, int], likely_deg: float
                 ) -> Iterator[Attempt]:
        """
        Yield the result of each search of an image of shape (H, W) px.

        likely_deg is the field of view of the long side that is searched first.
        """
        yield from self._identify(lists, shape, likely_deg, _STEPS, _TIME_LIMIT_S)

    def identify_mirrored(self, lists: Iterable[Centroids], shape: tuple[int, int],
                          likely_deg: float) -> Iterator[Attempt]:
        """Yield the results of a quick search in lists that are flipped from left to right."""
        yield from self._identify(lists, shape, likely_deg, _STEPS[:1], _MIRRORED_LIMIT_S)

    def _identify(self, lists: Iterable[Centroids], shape: tuple[int, int], likely_deg: float,
                  steps: Sequence[Step], left_s: float) -> Iterator[Attempt]:
        if shape != self._shape:
            self._shape, self._identifiers = shape, {}
        order = np.argsort(np.abs(np.log(_TANGENTS / np.tan(np.radians(likely_deg) / 2))))
        likely, others = order[:_LIKELY_FIELDS], order[_LIKELY_FIELDS:]
        first = [*product(steps[:2], likely)]
        all_of_them = chain(first, product(steps[:1], others), product(steps[2:], likely),
                            product(steps[1:], others))
        short_s, long_s = _PASSES_S
        for time_s, (step, field) in chain(product([short_s], first),
                                           product([long_s], all_of_them)):
            nominal = _camera(shape, _TANGENTS[field])
            if np.degrees(nominal.pixel_rad) > COARSEST_PIXEL_DEG:
                continue
            identifier = self._identifier(int(field), step, nominal)
            identifier.prepare()
            for centroids in islice(lists, _LISTS):
                start_s = time.thread_time()
                found = identifier.identify_within(centroids, time_s)
                left_s -= time.thread_time() - start_s
                yield Attempt(found, identifier, centroids, nominal)
                if left_s < 0:
                    return

    def _identifier(self, field: int, step: Step, nominal: Camera) -> _BlindPyramid:
        key = field, step
        if key not in self._identifiers:
            camera = replace(nominal, fy=nominal.fy * step.pixel_ratio)
            options = replace(self._options, sigma_floor_px=step.sigma_floor_px)
            self._identifiers[key] = self._database(field).with_camera(camera, options)
        return self._identifiers[key]

    def _database(self, field: int) -> _BlindPyramid:
        widest = min(field // _FIELDS_PER_DATABASE * _FIELDS_PER_DATABASE
                     + _FIELDS_PER_DATABASE, len(_TANGENTS)) - 1
        if widest not in self._databases:
            camera = _camera((_HEIGHT, _WIDTH), _TANGENTS[widest])
            self._databases[widest] = _BlindPyramid(
                camera, self._epoch_year, self._options, camera_catalog(camera, self._deep))
        return self._databases[widest]


def _camera(shape: tuple[int, int], tangent: float) -> Camera:
    """Return the ideal camera whose long side has the tangent of half its field."""
    height, width = shape
    focal = max(shape) / 2 / float(tangent)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
