# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of an image by what another image of the same camera has shown: lens and attitude.

First an attitude is expected: that of the image before, with the turn of the Earth since then, or
with the turn between the last two. Each spot may be each star near its place there. Two such pairs
that are as far apart in the image as in the sky give an attitude; where it has two more stars at
spots, it is a candidate. These are few, so they find a few stars among many false spots.

An image that points elsewhere is identified by quads of any stars, as in blind.py, but by the lens
that is known: only those of its scale and of nearly their code are candidates. An image of another
camera is soon left.

Of T candidates tested so far, each has T times the false-alarm probability of a single one, as in
blind.py; of those near an expected one each attitude that two pairs give counts.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.verification import Verifier
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.photographs.blind import (
    accepted, BATCHES, BlindIdentifier, Candidates, Field, MOST_CANDIDATES, share_of_sky,
    StarsSeen, TOLERANCE, verified)
from startracker_ros.photographs.detections import points_and_peaks
from startracker_ros.photographs.ladder import Attempt
from startracker_ros.photographs.sky_quads import depths, image_quads, matching_neighbours
from startracker_ros.photographs.unknown_lens import share_of_fisheye, UnknownLensIdentifier

LENS_ERROR = 0.01
"""How far the focal length is from that of the other image at most: of focus and temperature."""

# How far stars are from where an expected attitude has them, and as a share of the field.
_NEAR_RAD, _NEAR_SHARE = np.radians(3.0), 0.1
_SPOTS, _STARS = 60, 200  # brightest ones that are tried there
_LEAST_APART = 0.1  # of the field: two pairs
_SAME_PX = 2.0  # error of a distance, and of the place of a star by two others
_MOST_PAIRS, _AT_ONCE, _VERIFIED = 500, 50, 3  # pairs of pairs of an attitude, and candidates
# Of an image that points elsewhere, quads of so many stars: most have the brightest ones.
_ELSEWHERE = BATCHES[:4]


class Known(NamedTuple):
    """
    A lens, attitudes (A, 4) q_icrf_from_sensor that are expected, and the image it is of.

    certain is whether no other lens is to be searched, error that of its focal length, as a share.
    fixed (F, 2) px are places of spots that do not move with the stars.
    """

    camera: Camera
    expected: np.ndarray
    source: str
    certain: bool = False
    error: float = LENS_ERROR
    fixed: np.ndarray | None = None

    @property
    def fov_deg(self) -> float | None:
        """
        Return the horizontal field of view, None of a fisheye.

        Rounded, so that the images of a camera have the same databases.
        """
        fov_deg = float(np.degrees(self.camera.fov_x_rad))
        return None if self.camera.model.equidistant else float(f'{fov_deg:.2g}')


class SameCamera:
    """Identifies images of cameras whose lens is known."""

    def __init__(self, blind: BlindIdentifier, unknown: UnknownLensIdentifier,
                 options: IdentificationOptions) -> None:
        """Tables and catalogues are those of other searches."""
        self._blind, self._unknown, self._options = blind, unknown, options
        self._field: Field | None = None
        self._error = LENS_ERROR

    def identify(self, lists: Iterable[Centroids], known: Known) -> Iterator[Attempt]:
        """Yield each identification of an image of a lens."""
        camera = known.camera
        if self._field is None or (self._field.camera, self._error) != (camera, known.error):
            onboard = (self._unknown.onboard if camera.model.equidistant
                       else self._blind.catalogue(camera))
            self._field = Field(camera, onboard, Verifier(
                camera, onboard, self._options.tolerance_sigmas, known.error, lens_known=False))
            self._error = known.error
        seen, tested = StarsSeen(self._options), 0
        # A list is made when it is first used.
        for centroids in points_and_peaks(lists):
            for attitude in matrix_from_quaternion(known.expected):
                _, direction, _ = seen.by(camera, centroids)
                for base, star, count in _near(self._field, direction[:_SPOTS], attitude):
                    tested += count
                    for one, four in zip(base, star):
                        yield from self._seen(accepted, Candidates(
                            centroids, one, self._field.onboard.hip[four]), seen, tested)
        for centroids in points_and_peaks(lists):
            for first, last in pairwise(_ELSEWHERE if known.source else BATCHES):
                candidates = self._candidates(self._field, centroids, seen, first, last)
                tested += len(candidates.base)
                yield from self._seen(verified, candidates, seen, tested)

    def _seen(self, verify: Callable[..., Attempt | None], candidates: Candidates,
              seen: StarsSeen, tested: int) -> Iterator[Attempt]:
        """Yield the accepted one of some candidates, if there is one."""
        assert self._field is not None
        if not len(candidates.base):
            return
        attempt = verify(self._field, candidates, seen, tested, self._options, self._blind.years)
        if attempt is not None:
            yield attempt._replace(nominal=self._field.camera)

    def _candidates(self, field: Field, centroids: Centroids, seen: StarsSeen, first: int,
                    last: int) -> Candidates:
        """Return the candidates of the quads whose last star is first to last - 1."""
        _, direction, _ = seen.by(field.camera, centroids)
        area = _solid_angle(field.camera)
        tried = image_quads(len(direction), first, last)
        base, number = [np.empty((0, 4), np.int32)], [np.empty((0, 4), np.int32)]
        for catalog, quads, density in self._blind.tables(field.camera):
            chosen = tried[depths(direction, tried, area) < density]
            image, row, _ = matching_neighbours(
                quads.table, direction, chosen, TOLERANCE, 1 - self._error, 1 + self._error,
                MOST_CANDIDATES)
            base.append(image)
            number.append(catalog.hip[quads.table.star[row]])
        return Candidates(centroids, np.concatenate(base), np.concatenate(number))


def _solid_angle(camera: Camera) -> float:
    """Return that of an image, sr."""
    share = (share_of_fisheye(camera.native) if camera.model.equidistant
             else share_of_sky(camera))
    return 4 * np.pi * share


def _near(field: Field, spot: np.ndarray, attitude: np.ndarray
          ) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """
    Yield spots (K, 4) and stars (K, 4) near an attitude (3, 3), and how many attitudes were tried.

    spot (N, 3) are directions of the sensor; attitude turns them to ICRS.
    """
    camera, icrf = field.camera, field.onboard.direction
    limit = min(_NEAR_RAD, _NEAR_SHARE * camera.fov_x_rad)
    row = np.flatnonzero(icrf @ attitude[:, 2] > np.cos(
        min(camera.corner_angle_rad + limit, np.pi)))[:_STARS]
    seen = icrf[row] @ attitude
    i, j = np.nonzero(spot @ seen.T > np.cos(limit))
    a, b = np.triu_indices(len(i), 1)
    apart = np.linalg.norm(spot[i[a]] - spot[i[b]], axis=1)
    same = _SAME_PX * camera.pixel_rad
    pairs = np.flatnonzero(
        (np.abs(apart - np.linalg.norm(seen[j[a]] - seen[j[b]], axis=1)) < same)
        & (apart > _LEAST_APART * camera.fov_x_rad))[:_MOST_PAIRS]
    for first in range(0, len(pairs), _AT_ONCE):
        one, other = a[pairs[first:first + _AT_ONCE]], b[pairs[first:first + _AT_ONCE]]
        turn = (_axes(spot[i[one]], spot[i[other]])
                @ _axes(seen[j[one]], seen[j[other]]).transpose(0, 2, 1))
        # The spot nearest to where each of these attitudes has a star.
        cosine = seen @ turn.transpose(0, 2, 1) @ spot.T
        at, there = cosine.argmax(axis=2), cosine.max(axis=2) > np.cos(same)
        stars = there.sum(axis=1)
        base, four = [np.empty((0, 4), np.int32)], [np.empty((0, 4), int)]
        for best in np.argsort(-stars, kind='stable')[:_VERIFIED]:
            # Its first four stars, brightest first, each at a spot of its own.
            places = np.flatnonzero(there[best])
            spots, once = np.unique(at[best][places], return_index=True)
            if len(spots) >= 4:
                chosen = places[np.sort(once)[:4]]
                base.append(at[best][chosen][None].astype(np.int32))
                four.append(row[chosen][None])
        # All pairs of the stars of a candidate give the same attitude.
        whole = stars >= 4
        tried = (len(np.unique(np.where(there, at, -1)[whole], axis=0))
                 + int(np.count_nonzero(~whole)))
        yield np.concatenate(base), np.concatenate(four), tried


def _axes(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return axes (K, 3, 3), in columns, of two directions (K, 3) each."""
    middle, across = one + other, np.cross(one, other)
    middle, across = (axis / np.linalg.norm(axis, axis=1, keepdims=True)
                      for axis in (middle, across))
    return np.stack([middle, np.cross(across, middle), across], axis=2)
