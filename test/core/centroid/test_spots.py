# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Spots of any shape: stars above a skyline, which is not a star itself."""

import numpy as np
import pytest
from startracker_ros.core.centroid.extraction import CentroidExtractor

MAX_STARS = 60
HEIGHT, WIDTH, STARS = 600, 800, 40


def all_sky(rng):
    """Return an image of a bright sky in a circle of black trees, and the pixels of its stars."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    towards = np.arctan2(v - HEIGHT / 2, u - WIDTH / 2)
    trees = 0.42 * HEIGHT + np.interp(
        towards.ravel(), np.linspace(-np.pi, np.pi, 400), rng.uniform(-14, 14, 400)
        ).reshape(HEIGHT, WIDTH)
    image = np.where(np.hypot(v - HEIGHT / 2, u - WIDTH / 2) < trees, 80.0, 8.0)
    angle = rng.uniform(0, 2 * np.pi, STARS)
    radius = 0.36 * HEIGHT * np.sqrt(rng.uniform(size=STARS))
    uv = [WIDTH / 2, HEIGHT / 2] + (radius * [np.cos(angle), np.sin(angle)]).T
    for x, y in uv:
        image += 40 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 1.2 ** 2))
    return (image + rng.normal(0, 2, image.shape)).clip(0, 255).astype(np.uint8), uv


def test_the_skyline_leaves_room_for_the_stars():
    """Corners of the sky between trees are brighter than stars, and more than a list holds."""
    seen = others = 0
    for seed in range(4):
        image, uv = all_sky(np.random.default_rng(seed))
        spots = CentroidExtractor().find_spots(image)
        near = np.linalg.norm(spots.uv[:, None] - uv, axis=2) < 2
        assert len(spots) <= MAX_STARS
        seen += near.any(axis=0).sum()
        others += (~near.any(axis=1)).sum()
    assert seen >= 0.94 * 4 * STARS and others < 0.35 * 4 * STARS


def test_neighbours_and_slopes_leave_a_spot():
    """A close pair in the glare of a lamp."""
    v, u = np.mgrid[:200, :200]
    image = 0.3 * v + np.random.default_rng(1).normal(0, 1, (200, 200))
    stars = [(60, 60), (68, 60), (140, 150)]
    for x, y in stars:
        image += 60 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 1.3 ** 2))
    spots = CentroidExtractor().find_spots(image.clip(0, 65535).astype(np.uint16))
    for star in stars:
        assert np.linalg.norm(spots.uv - star, axis=1).min() < 0.5


@pytest.mark.slow
def test_spots_in_calm_surroundings_are_the_stars_beside_a_lit_tree():
    """All its leaves are brighter than the stars."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rng = np.random.default_rng(1)
    stars = np.array([(x, y) for x in range(40, 400, 70) for y in range(40, 600, 70)])
    leaves = np.array([(x, y) for x in range(520, 780, 13) for y in range(20, 580, 13)])
    image = rng.normal(40, 2, (HEIGHT, WIDTH))
    for spots, height in ((stars, 40), (leaves, 120)):
        for x, y in spots + rng.uniform(-2, 2, spots.shape):
            image += height * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 1.3 ** 2))
    image = image.clip(0, 255).astype(np.uint8)
    assert np.count_nonzero(CentroidExtractor().find_spots(image).uv[:, 0] < 480) < len(stars) / 2
    calm = CentroidExtractor().find_spots(image, calm=True)
    apart = np.linalg.norm(calm.uv[:, None] - stars, axis=2)
    # The rest of the list is for the calmest leaves.
    assert (apart.min(axis=0) < 4).all()
    assert np.count_nonzero(apart.min(axis=1) > 4) <= MAX_STARS - len(stars)
