# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Takes hits, trails, columns and discs out of an image: what contaminates much of it."""

from typing import NamedTuple

import cv2
import numpy as np
from startracker_ros.core.centroid.background import Mesh, over_image, pixel_noise, readable
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.hits import is_storm, without_hits

LARGE_PX = 120  # across; the longest streak of a star is shorter
LARGE_PEAKS = 30  # on lines and discs, from which on these are taken out as a whole
LARGE_SIGMAS = 3.0  # above the background
MARGIN_PX = 3  # around something large, where its flux falls below that
MAX_SHARE = 0.6  # of the image; more is no artefact in a field of stars


class Contamination(NamedTuple):
    """What contaminates an image: hits of particles, or something large."""

    hits: bool = False
    large: bool = False


CLEAN = Contamination()


def find_contamination(frame: Frame) -> Contamination:
    """Return what contaminates the image of a frame."""
    search = frame.search
    return Contamination(
        search.too_many or is_storm(frame.image, search.peaks.uv, search.peaks.level),
        len(search.lines) + len(search.discs) >= LARGE_PEAKS)


def cleaned(image: np.ndarray, mesh: Mesh, contamination: Contamination, sigma_px: float
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return image (H, W) without what contaminates it, and the pixels u, v (N, 2) of hits.

    mesh is its background, sigma_px the width of its stars. What is taken out gets the level of
    the background.
    """
    noise_dn, hits = pixel_noise(image), np.empty((0, 2), int)
    if contamination.large:
        image = _without_large(image, over_image(mesh.level, image.shape), noise_dn)
    if contamination.hits:
        image, hit = without_hits(image, mesh, noise_dn, sigma_px)
        hits = np.argwhere(hit)[:, ::-1]
    return readable(image), hits


def _without_large(image: np.ndarray, level: np.ndarray, noise_dn: float) -> np.ndarray:
    """Return image (H, W) without connected bright pixels that extend over LARGE_PX."""
    bright = (image > level + np.float32(LARGE_SIGMAS * noise_dn)).astype(np.uint8)
    _, label, box, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    across = np.maximum(box[:, cv2.CC_STAT_WIDTH], box[:, cv2.CC_STAT_HEIGHT])
    large = (across > LARGE_PX) & (np.arange(len(box)) > 0)
    if not large.any():
        return image
    side = 2 * MARGIN_PX + 1
    mask = cv2.dilate(large.astype(np.uint8)[label], np.ones((side, side), np.uint8)) > 0
    if mask.mean() > MAX_SHARE:
        return image
    clean = image.copy()
    clean[mask] = np.rint(level[mask]).clip(0, np.iinfo(image.dtype).max)
    return readable(clean)
