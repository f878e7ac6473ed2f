# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fisheyes of any projection are identified without any knowledge of them, and noise is none."""

import numpy as np
import pytest
from startracker_ros.core.calibration.fisheye import FisheyeIdentifier, neighbours
from startracker_ros.core.calibration.learnt_lens import learn_lens
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.blind import BlindIdentifier, LENS_ERROR
from startracker_ros.core.maths.rotation import matrix_from_quaternion, random_attitude

EPOCH_YEAR = 2030.0
NOISE_PX, FALSE = 0.3, 30
PROJECTIONS = {
    'stereographic': lambda theta: 2 * np.tan(theta / 2),
    'equidistant': lambda theta: theta,
    'equisolid': lambda theta: 2 * np.sin(theta / 2),
    'orthographic': lambda theta: np.sin(np.minimum(theta, np.pi / 2)),
    'polynomial': lambda theta: theta - 0.05 * theta ** 3 - 0.005 * theta ** 5}
SHAPES = (1000, 1000), (960, 1280), (1080, 1920)


def centroids(uv, flux):
    order = np.argsort(-flux)
    count = len(uv)
    return Centroids(uv[order], flux[order], np.full(count, 50.0), np.full(count, NOISE_PX))


class Night:
    """
    What a fisheye of unknown centre sees of a random sky above a horizon, with a Moon.

    The circle of fov_deg fits the image, or half of it is cropped. direction (N, 3) and uv (N, 2)
    are stars on the axes of the lens and without errors.
    """

    def __init__(self, rng, projection, shape=None):
        self.shape = height, width = shape or SHAPES[rng.integers(len(SHAPES))]
        fov_rad = np.radians(rng.uniform(100.0, 180.0 if projection == 'orthographic' else 190.0))
        radius_px = min(height, width) / 2 * rng.uniform(0.85, 1.4)
        self.map = PROJECTIONS[projection]
        self.focal_px = radius_px / self.map(fov_rad / 2)
        self.centre = ([(width - 1) / 2, (height - 1) / 2]
                       + rng.uniform(-0.05, 0.05, 2) * min(height, width))
        catalog = load_catalog().brighter_than(rng.uniform(4.0, 5.0))
        self.matrix = matrix_from_quaternion(random_attitude(rng))
        sensor = catalog.directions(EPOCH_YEAR) @ self.matrix
        theta, azimuth = self._angles(sensor)
        # Hills and trees hide up to 15 deg above the edge of the field.
        hidden = np.radians(8 + 7 * np.sin(3 * azimuth + rng.uniform(0, 6)))
        moon = rng.normal(size=3)
        moon /= np.linalg.norm(moon)
        uv = self.pixels(sensor)
        seen = ((theta < fov_rad / 2 - np.where(fov_rad > 2.9, hidden, 0))
                & (sensor @ moon < np.cos(np.radians(10.0)))
                & (uv > 0).all(1) & (uv < [width - 1, height - 1]).all(1))
        self.direction, self.uv = sensor[seen], uv[seen]
        # The air absorbs towards the horizon.
        magnitude = (catalog.magnitude[seen] + rng.normal(0, 0.3, len(uv[seen]))
                     + 0.2 / np.maximum(np.cos(theta[seen]), 0.1))
        uv = np.vstack([self.uv + rng.normal(0, NOISE_PX, self.uv.shape),
                        rng.uniform(0, [width - 1, height - 1], (FALSE, 2))])
        flux = 10 ** (-0.4 * magnitude)
        self.centroids = centroids(uv, np.concatenate([flux, rng.choice(flux, FALSE)]))

    @staticmethod
    def _angles(sensor):
        return (np.arctan2(np.hypot(sensor[:, 0], sensor[:, 1]), sensor[:, 2]),
                np.arctan2(sensor[:, 1], sensor[:, 0]))

    def pixels(self, sensor):
        theta, azimuth = self._angles(sensor)
        return self.centre + self.focal_px * self.map(theta)[:, None] * np.stack(
            [np.cos(azimuth), np.sin(azimuth)], axis=1)

    def error_deg(self, lens):
        """Return the largest error of the directions of stars in a fitted lens, median."""
        own = lens.camera.unproject(self.uv) @ matrix_from_quaternion(lens.axis_quaternion).T
        chord = np.linalg.norm(own - self.direction @ self.matrix.T, axis=1)
        return np.degrees(np.nanmedian(chord))


def first_lens(identifier, night):
    """Return the first accepted lens, None for none."""
    for attempt in identifier.identify([night.centroids], night.shape):
        lens = learn_lens(attempt, LENS_ERROR)
        if not lens.rejected:
            return lens
    return None


@pytest.fixture(scope='module')
def identifier():
    return FisheyeIdentifier(EPOCH_YEAR, BlindIdentifier(EPOCH_YEAR).wide_quads)


@pytest.mark.parametrize('projection', PROJECTIONS)
def test_a_fisheye_of_any_projection_is_found_and_fitted(identifier, projection):
    rng, solved = np.random.default_rng(len(projection)), 0
    for _ in range(6):
        night = Night(rng, projection)
        lens = first_lens(identifier, night)
        if lens is not None:
            seen = lens.camera.project(
                night.direction @ night.matrix.T @ matrix_from_quaternion(lens.axis_quaternion))
            off_px = np.linalg.norm(seen - night.uv, axis=1)
            assert np.median(off_px) < NOISE_PX
            solved += 1
    # Of two hundred simulated fisheyes of each projection at least 98 % are found.
    assert solved >= 5


@pytest.mark.parametrize('kind', ['uniform', 'ring', 'few'])
def test_spots_that_are_no_stars_are_no_fisheye(identifier, kind):
    rng, (height, width) = np.random.default_rng(2), SHAPES[1]
    for _ in range(4):
        uv = rng.uniform([0, 0], [width - 1, height - 1], (12 if kind == 'few' else 60, 2))
        if kind == 'ring':
            # Lights along the horizon.
            angle = rng.uniform(0, 2 * np.pi, 40)
            uv[:40] = [width / 2, height / 2] + rng.normal(440, 8, (40, 1)) * np.stack(
                [np.cos(angle), np.sin(angle)], axis=1)
        spots = centroids(uv, 10 ** rng.uniform(2, 4, len(uv)))
        assert not [*identifier.identify([spots], SHAPES[1])]


def test_a_mirrored_fisheye_is_found_only_mirrored(identifier):
    night = Night(np.random.default_rng(4), 'equisolid')
    flipped = centroids([night.shape[1] - 1, 0] + night.centroids.uv * [-1, 1],
                        night.centroids.flux)
    assert not [*identifier.identify([flipped], night.shape)]
    assert next(identifier.identify_mirrored([night.centroids], night.shape), None) is not None


def test_quads_of_neighbours_are_each_once():
    uv = np.random.default_rng(1).uniform(0, 1000, (30, 2))
    quads = neighbours(uv)
    assert len(np.unique(quads, axis=0)) == len(quads) > 300
    assert (np.diff(quads, axis=1) > 0).all()
    # So few are all neighbours of each other.
    assert len(neighbours(uv[:6])) == 15 and not len(neighbours(uv[:3]))
