# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The frames of the lost-in-space comparison: cameras, cells, simulated centroids."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
import zlib

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import quaternion_from_pointing, random_attitude

EPOCH_YEAR = 2026.5

_PLEIADES_DEG = (56.75, 24.12)
_MAGNITUDE_SIGMA = 0.1


@dataclass(frozen=True)
class View:
    """A camera, its field of view across the width, and its magnitude limit V."""

    name: str
    width: int
    fov_deg: float
    magnitude_limit: float

    @cached_property
    def camera(self) -> Camera:
        """Return the camera of the frames."""
        return Camera.from_fov(self.width, self.width, self.fov_deg)

    @cached_property
    def onboard(self) -> OnboardCatalog:
        """Return the stars that the camera can detect."""
        return onboard_catalog(camera_catalog(self.camera), self.camera, EPOCH_YEAR,
                               self.magnitude_limit)


VIEWS = {view.name: view for view in (
    View('A12', 512, 12.0, 6.0), View('B20', 1024, 20.0, 5.5), View('C10', 1024, 10.0, 6.5))}


@dataclass(frozen=True)
class Cell:
    """
    The conditions of the frames of one cell.

    sigma_px is the centroid noise per axis, missing the share of undetected stars,
    false the number of false stars. sky is `any`; `none`: as many false stars as a real
    field has stars; `mirrored`: a real field left to right; `Pleiades`: around them.
    focal_ratio is the true focal length over that of the solvers, which know it to
    fov_error_percent.
    """

    sigma_px: float = 0.3
    missing: float = 0.0
    false: int = 0
    sky: str = 'any'
    focal_ratio: float = 1.0
    # Not of the frames: their seed is of the printed cell.
    fov_error_percent: float = field(default=0.5, repr=False)

    @property
    def name(self) -> str:
        """Return the name of the cell in --only."""
        return (f'{self.sigma_px:g}px' + (f'-{self.missing:.0%}missing' if self.missing else '')
                + (f'-{self.false}false' if self.false else '')).replace('%', '')


_TRAPS = {
    'false-only': Cell(sky='none'),
    'mirrored': Cell(sky='mirrored'),
    # A wrong scale makes many chance matches in the corner with the cluster.
    'pleiades-3-percent-off': Cell(sky='Pleiades', focal_ratio=1.03, fov_error_percent=5.0),
    'field-5-percent-off': Cell(focal_ratio=1.05, fov_error_percent=5.0),
}
_PRODUCT = [Cell(*factors) for factors in product(
    (0.1, 0.3, 0.5, 1.0), (0.0, 0.05, 0.2), (0, 3, 10, 20))]
_CHOSEN = [
    *(cell for cell in _PRODUCT if not cell.missing and not cell.false),
    Cell(0.3, 0.05), Cell(0.3, 0.2), Cell(0.3, 0.0, 3), Cell(0.3, 0.0, 10), Cell(0.3, 0.0, 20),
    Cell(0.3, 0.2, 10), Cell(1.0, 0.2, 10), Cell(1.0, 0.2, 20)]

ALL_CELLS = {cell.name: cell for cell in _PRODUCT} | _TRAPS
CELLS = {cell.name: cell for cell in _CHOSEN} | _TRAPS
"""One factor after the other, and combinations; ALL_CELLS has every combination."""


@dataclass(frozen=True)
class Frame:
    """
    Centroids, brightest first, and their true q_icrf_from_sensor (4,).

    truth is None where no attitude is correct.
    """

    centroids: Centroids
    truth: np.ndarray | None


def frames(view: View, cell: Cell, count: int, seed: int) -> list[Frame]:
    """Return frames that depend on nothing but the arguments."""
    rng = np.random.default_rng([seed, zlib.crc32(f'{view}{cell}'.encode())])
    return [_frame(view, cell, rng) for _ in range(count)]


def _frame(view: View, cell: Cell, rng: np.random.Generator) -> Frame:
    q = _near_pleiades(view, rng) if cell.sky == 'Pleiades' else random_attitude(rng)
    seen, _ = star_list(view.onboard, view.camera, q, cell.sigma_px, rng, missing=cell.missing,
                        false=cell.false, magnitude_sigma=_MAGNITUDE_SIGMA)
    if cell.sky == 'none':
        seen, _ = star_list(view.onboard, view.camera, q, cell.sigma_px, rng, missing=1.0,
                            false=len(seen))
    elif cell.sky == 'mirrored':
        seen = replace(seen, uv=seen.uv * [-1, 1] + [view.width - 1, 0])
    return Frame(seen, None if cell.sky in ('none', 'mirrored') else q)


def _near_pleiades(view: View, rng: np.random.Generator) -> np.ndarray:
    """Return an attitude with the cluster off the centre but in the image."""
    ra_deg, dec_deg = _PLEIADES_DEG + rng.uniform(-1, 1, 2) * view.fov_deg / 3
    return quaternion_from_pointing(*np.radians([ra_deg, dec_deg, rng.uniform(0, 360)]))
