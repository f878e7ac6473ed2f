# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs with known answers: folders with a solutions.csv beside the images."""

from collections.abc import Iterator, Sequence
import csv
from dataclasses import dataclass
from pathlib import Path
import re

import numpy as np
from startracker_ros.core.maths.rotation import unit_from_radec
from startracker_ros.io.images.images import read_image

REPOSITORY_IMAGES = Path(__file__).parents[3] / 'test' / 'data'
"""Where a clone of the repository has its images; an installed package has none."""

CORRECT_OF_FIELD = 0.01
"""Largest error of the image centre of a correct solution, as a share of the field of view."""

_EPOCH_YEAR = 2019.5  # where the note of an image has none


class FolderError(ValueError):
    """A folder without images of known answers; the text names it."""


@dataclass(frozen=True)
class Photograph:
    """An image (H, W), its horizontal field of view and the direction (3,) of its centre."""

    group: str
    path: Path
    image: np.ndarray
    fov_deg: float
    centre: np.ndarray
    epoch_year: float

    def is_correct(self, direction: np.ndarray) -> bool:
        """Return whether a direction (3,) is that of the image centre."""
        limit_rad = CORRECT_OF_FIELD * np.radians(self.fov_deg)
        return bool(np.linalg.norm(direction - self.centre) < limit_rad)


def photographs(folders: Sequence[Path]) -> list[Photograph]:
    """
    Return the images of all solutions.csv below the folders that have a known answer.

    FolderError for a folder without any; ImageError for an unreadable image.
    """
    found = []
    for folder in folders:
        here = [image for table in sorted(folder.rglob('solutions.csv')) for image in _of(table)]
        if not here:
            raise FolderError(f'{folder}: no solutions.csv with known images')
        found += here
    return found


def _of(table: Path) -> Iterator[Photograph]:
    with table.open(newline='') as file:
        for row in csv.DictReader(file):
            if not row['ra_deg']:
                continue
            path = table.parent / row['file']
            epoch = re.search(r'epoch (\d+(\.\d+)?)', row.get('note', ''))
            yield Photograph(
                path.parent.name, path, read_image(path),
                float(row.get('hfov_deg') or row['fov_deg_about']),
                unit_from_radec(*np.radians([float(row['ra_deg']), float(row['dec_deg'])])),
                float(epoch[1]) if epoch else _EPOCH_YEAR)
