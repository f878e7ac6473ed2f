"""The sky as one camera can see it: close doubles merged, disturbed stars marked."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import StarCatalog

MERGE_PX = 2.0
"""Stars closer than this are one image. Two equal Gaussians of 1 px sigma show two peaks
only when more than 2 sigma apart; nearer than that any centroid lands on their common
centre of light."""

CROWD_PX = 6.0
"""A neighbour nearer than this may disturb a centroid: twice a window of radius 3 px,
which holds 99 % of the light of a PSF of 1 px sigma."""

CROWD_MAGNITUDES = 2.5
"""How much fainter than its star a disturbing neighbour may be. At a tenth of the light
it pulls the centre of light by a tenth of the overlap: some 0.1 px, the noise of a star
near the detection limit."""


@dataclass(frozen=True)
class StarPlaces:
    """
    Star images at one epoch, brightest first.

    hip (N,) int32 names the brightest component; direction (N, 3) holds unit vectors in
    ICRS; magnitude (N,) is that of all components together; crowded (N,) is True where a
    neighbour disturbs the centroid.
    """

    hip: np.ndarray
    direction: np.ndarray
    magnitude: np.ndarray
    crowded: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def within(self, center: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return indices (M,) of the stars up to radius_rad from center (3,), brightest first."""
        return np.flatnonzero(self.direction @ center >= np.cos(min(radius_rad, np.pi)))

    def index_of(self, hip: np.ndarray) -> np.ndarray:
        """Return the index (M,) of each Hipparcos number (M,), -1 where it is not here."""
        hip = np.asarray(hip)
        order, ranked = self._by_hip
        if not len(ranked):
            return np.full(hip.shape, -1)
        rank = np.minimum(np.searchsorted(ranked, hip), len(ranked) - 1)
        return np.where(ranked[rank] == hip, order[rank], -1)

    @cached_property
    def _by_hip(self) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(self.hip)
        return order, self.hip[order]


def star_places(catalog: StarCatalog, epoch_year: float, *, magnitude_limit: float,
                merge_rad: float, crowd_rad: float) -> StarPlaces:
    """
    Return the star images up to magnitude_limit at a Julian year.

    Stars linked by gaps below merge_rad become one image at their centre of light: a
    double belongs to the sky when its magnitude as a whole is within the limit. Every
    star of the catalogue counts as a component and as a neighbour, so that an image stands
    at the same place whatever the limit.
    """
    star = catalog.directions(epoch_year)
    pairs = _close_pairs(star, _chord(max(merge_rad, crowd_rad)))
    gap = np.linalg.norm(star[pairs[:, 0]] - star[pairs[:, 1]], axis=1)
    count, image = _components(pairs[gap <= _chord(merge_rad)], len(catalog))
    flux = 10 ** (-0.4 * catalog.magnitude.astype(float))
    magnitude = -2.5 * np.log10(np.bincount(image, flux, count))
    direction = np.stack([np.bincount(image, flux * axis, count) for axis in star.T], -1)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    # Stars come brightest first, so the first of an image is its brightest component.
    brightest = np.unique(image, return_index=True)[1]
    crowded = _crowded(image[pairs[gap <= _chord(crowd_rad)]], magnitude)

    order = np.argsort(magnitude, kind='stable')
    # In float32 as the catalogue: a star at the limit is not lost to rounding.
    order = order[magnitude[order].astype(np.float32) <= np.float32(magnitude_limit)]
    return StarPlaces(catalog.hip[brightest[order]], direction[order], magnitude[order],
                      crowded[order])


def camera_places(catalog: StarCatalog, camera: Camera, epoch_year: float,
                  magnitude_limit: float = np.inf) -> StarPlaces:
    """Return the star images of a camera, resolved as finely as its pixels allow."""
    return star_places(catalog, epoch_year, magnitude_limit=magnitude_limit,
                       merge_rad=MERGE_PX * camera.pixel_rad,
                       crowd_rad=CROWD_PX * camera.pixel_rad)


def _close_pairs(direction: np.ndarray, chord: float) -> np.ndarray:
    """
    Return the pairs (P, 2) of unit vectors (N, 3) that are no further than chord apart.

    The space around the sphere is cut into cells of edge chord, numbered along the third axis
    first: partners stand in three cells in a row, of the own row and of the eight around it.
    Four of these and the way ahead in the own one meet each pair once. This is as fast as
    SciPy's tree, whose import would cost each node more than all else here.
    """
    edge = max(chord, 1e-5)
    cells = int(2 / edge) + 3
    place = ((direction + 1) / edge).astype(np.int64) + 1
    cell = (place[:, 0] * cells + place[:, 1]) * cells + place[:, 2]
    order = np.argsort(cell, kind='stable')
    cell = cell[order]
    rank = np.arange(len(cell))
    pairs = []
    for row in (0, 1, cells - 1, cells, cells + 1):
        begin = np.searchsorted(cell, cell + row * cells - 1) if row else rank + 1
        count = np.searchsorted(cell, cell + row * cells + 1, side='right') - begin
        # All partners of the first star, those of the second and so on, in a row.
        passed = np.repeat(np.cumsum(count) - count - begin, count)
        first, second = order[np.repeat(rank, count)], order[np.arange(len(passed)) - passed]
        gap = direction[first] - direction[second]
        near = np.einsum('ij,ij->i', gap, gap) <= chord ** 2
        pairs.append(np.stack([first[near], second[near]], -1))
    return np.concatenate(pairs)


def _components(pairs: np.ndarray, size: int) -> tuple[int, np.ndarray]:
    """Return how many groups pairs (P, 2) join size stars into, and each star's group."""
    lowest = np.arange(size)
    while (lowest[pairs[:, 0]] != lowest[pairs[:, 1]]).any():
        # Each star takes over the lowest member that its partners know of, and what that knows.
        np.minimum.at(lowest, pairs, lowest[pairs].min(axis=1, keepdims=True))
        lowest = lowest[lowest]
    members, group = np.unique(lowest, return_inverse=True)
    return len(members), group


def _crowded(pairs: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Return True (N,) for images disturbed by their partner among pairs (P, 2) of images."""
    crowded = np.zeros(len(magnitude), bool)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    for image, neighbour in (pairs.T, pairs.T[::-1]):
        fainter_by = magnitude[neighbour] - magnitude[image]
        crowded[image[fainter_by <= CROWD_MAGNITUDES]] = True
    return crowded


def _chord(angle_rad: float) -> float:
    """Return the distance between two unit vectors an angle apart."""
    return 2 * np.sin(angle_rad / 2)
