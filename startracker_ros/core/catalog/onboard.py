# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The on-board catalogue of a camera: close doubles merged, blended stars marked."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.camera.calibrated import check_pixels
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, pairs_within, sky_angles, sky_grid, SkyGrid)
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.maths.sorting import lowest_connected
from startracker_ros.core.stored_arrays import digest, StoredArrays

MERGE_PX = 2.0
"""Stars with a smaller separation are one catalogue entry. Two equal Gaussians of 1 px sigma have
two peaks only beyond a separation of 2 sigma; below it a centroid is that of their sum."""

CROWD_PX = 6.0
"""Neighbours within this separation may blend with a star: twice a window of radius 3 px,
which holds 99 % of the light of a PSF of 1 px sigma."""

CROWD_MAGNITUDES = 2.5
"""Largest magnitude difference of a blended neighbour. With a tenth of the light it shifts the
centroid by a tenth of the overlap: some 0.1 px, the noise of a star near the detection limit."""


@dataclass(frozen=True)
class OnboardCatalog:
    """
    On-board catalogue: the stars as one camera resolves them at one epoch, brightest first.

    hip (N,) int32 is the number of the brightest component of an entry; direction (N, 3) are
    unit vectors in ICRS from the Earth, with parallax and without aberration; magnitude (N,) is
    that of all components together; crowded (N,) is True for entries blended with a neighbour.
    blended (N,) is True for these and for entries of several components, none much brighter than
    the others: the image may be elsewhere. crowd_rad is the separation of neighbours.
    variation_mag (N,) is the standard deviation of the brightness of a variable, 0 for others.
    motion (N, 3) and parallax_rad (N,) are those of StarCatalog.changes(). stored is where the
    arrays are mapped from, sky_share the share of the sky that it covers.
    """

    hip: np.ndarray
    direction: np.ndarray
    magnitude: np.ndarray
    crowded: np.ndarray
    blended: np.ndarray
    crowd_rad: float = 0.0
    variation_mag: np.ndarray | None = None
    motion: np.ndarray | None = None
    parallax_rad: np.ndarray | None = None
    epoch_year: float = np.nan
    stored: StoredArrays | None = None
    sky_share: float = 1.0

    def __len__(self) -> int:
        return len(self.hip)

    def after(self, years: float) -> 'OnboardCatalog':
        """Return the same entries so many years later, without the change of parallax."""
        if self.motion is None:
            return self
        return replace(self, direction=_normalised(self.direction + years * self.motion),
                       epoch_year=self.epoch_year + years)

    def at(self, epoch_year: float) -> 'OnboardCatalog':
        """Return the same entries at a Julian year near epoch_year, with motion and parallax."""
        if epoch_year == self.epoch_year or self.motion is None or self.parallax_rad is None:
            return self
        earth_au = earth_position_au(epoch_year) - earth_position_au(self.epoch_year)
        moved = self.direction + (epoch_year - self.epoch_year) * self.motion.astype(float)
        moved -= self.parallax_rad[:, None].astype(float) * earth_au
        return replace(self, direction=_normalised(moved), epoch_year=epoch_year)

    def brighter_than(self, limit: float) -> 'OnboardCatalog':
        """Return the entries of magnitude up to and including limit."""
        # In float32 like the magnitudes of the catalogue: a star exactly at the limit is included.
        count = int(np.count_nonzero(self.magnitude.astype(np.float32) <= np.float32(limit)))
        if count == len(self):
            return self
        brightest: dict[str, Any] = {
            name: value[:count] for name, value in vars(self).items()
            if isinstance(value, np.ndarray)}
        return replace(self, **brightest)

    def within(self, center: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return the star indices (M,) up to radius_rad from center (3,), brightest first."""
        return np.flatnonzero(self.direction @ center >= np.cos(min(radius_rad, np.pi)))

    def index_of(self, hip: np.ndarray) -> np.ndarray:
        """Return the star index (M,) of each Hipparcos number (M,), -1 if it has no entry."""
        first, index = self._index_of_hip
        # Numbers beyond either end are clipped to entries of no star.
        return index.take(np.asarray(hip) - first, mode='clip').astype(int)

    @cached_property
    def grid(self) -> SkyGrid:
        """Return the directions by cell."""
        return sky_grid(self.direction)

    @cached_property
    def digest(self) -> str:
        """Return a digest of what identifies the content."""
        return digest(self.hip, self.direction, self.magnitude, self.crowded, self.blended,
                      self.crowd_rad, self.variation_mag)

    @cached_property
    def _index_of_hip(self) -> tuple[int, np.ndarray]:
        """One less than the least Hipparcos number, and star indices from there to one more."""
        first, last = (int(self.hip.min()), int(self.hip.max())) if len(self) else (1, 0)
        index = np.full(last - first + 3, -1, np.int32)
        index[self.hip - (first - 1)] = np.arange(len(self))
        return first - 1, index


def build_onboard_catalog(catalog: StarCatalog, epoch_year: float, *, magnitude_limit: float,
                          merge_rad: float, crowd_rad: float, least_density: float = 0.0,
                          sky_share: float = 1.0) -> OnboardCatalog:
    """
    Return the on-board catalogue up to magnitude_limit at a Julian year.

    It is deeper where that leaves fewer entries a steradian than least_density. sky_share is what
    the stars cover.

    Stars linked by separations below merge_rad become one entry at their photocentre, included
    if its total magnitude is within the limit. All stars of the catalogue are components and
    neighbours, so the direction of an entry does not depend on the limit.
    """
    earth_au = earth_position_au(epoch_year)
    direction = catalog.directions(epoch_year, earth_au)
    velocity, parallax_rad = catalog.changes(epoch_year, earth_au)
    pairs, square = pairs_within(
        sky_grid(direction, sky_share), _chord(max(merge_rad, crowd_rad)))
    merged, entry = np.unique(lowest_connected(
        pairs[square <= _chord(merge_rad) ** 2], len(catalog)), return_inverse=True)
    count = len(merged)
    flux = 10 ** (-0.4 * catalog.magnitude.astype(float))
    magnitude = -2.5 * np.log10(np.bincount(entry, flux, count))
    centre = np.stack([np.bincount(entry, flux * axis, count) for axis in direction.T], -1)
    length = np.linalg.norm(centre, axis=1, keepdims=True)
    direction = centre / length
    # Stars are in order of magnitude: the first one of an entry is its brightest component.
    brightest = np.unique(entry, return_index=True)[1]
    near = pairs[square <= _chord(crowd_rad) ** 2]
    crowded = _crowded(entry[near], magnitude)
    blended = crowded | _crowded(near, catalog.magnitude)[brightest]

    order = np.argsort(magnitude, kind='stable')
    # In float32 like the catalogue, so that a star exactly at the limit is included.
    chosen = magnitude[order].astype(np.float32) <= np.float32(magnitude_limit)
    if least_density:
        chosen |= brightest_everywhere(sky_angles(direction[order]), least_density)
    order = order[chosen]
    rows = brightest[order]
    motion, parallax = (
        # Of the photocentre, as the direction.
        np.stack([np.bincount(entry, flux * axis, count) for axis in of.T], -1) / length
        for of in (velocity, parallax_rad[:, None]))
    return OnboardCatalog(catalog.hip[rows], direction[order], magnitude[order], crowded[order],
                          blended[order], crowd_rad, catalog.variation_mag[rows],
                          motion[order].astype(np.float32),
                          parallax[order, 0].astype(np.float32), epoch_year,
                          sky_share=sky_share)


def onboard_catalog(catalog: StarCatalog, camera: Camera, epoch_year: float,
                    magnitude_limit: float = np.inf, least_density: float = 0.0,
                    sky_share: float = 1.0) -> OnboardCatalog:
    """
    Return build_onboard_catalog() of a camera, with the resolution of its pixels.

    CameraError for pixels so large that it would take long and have no stars.
    """
    check_pixels(camera)
    return build_onboard_catalog(catalog, epoch_year, magnitude_limit=magnitude_limit,
                                 merge_rad=MERGE_PX * camera.pixel_rad,
                                 crowd_rad=CROWD_PX * camera.pixel_rad,
                                 least_density=least_density, sky_share=sky_share)


def _crowded(pairs: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Return whether each image (N,) is blended with a neighbour among pairs (P, 2) of them."""
    crowded = np.zeros(len(magnitude), bool)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    for entry, neighbour in (pairs.T, pairs.T[::-1]):
        fainter_by = magnitude[neighbour] - magnitude[entry]
        crowded[entry[fainter_by <= CROWD_MAGNITUDES]] = True
    return crowded


def _normalised(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (N, 3), which are overwritten, at unit length."""
    vectors /= np.sqrt(np.einsum('ij,ij->i', vectors, vectors))[:, None]
    return vectors


def _chord(angle_rad: float) -> float:
    """Return the distance between two unit vectors separated by an angle."""
    return 2 * np.sin(angle_rad / 2)
