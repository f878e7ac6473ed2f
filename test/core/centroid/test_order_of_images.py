# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is extracted from an image does not depend on the images before."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.photographs.solve import solve_files

SIDE_PX = 192
SIGMA_IMAGES = 60  # for which a width stays known
# Number of stars, their width in px, particle hits, motion in px.
KINDS = ((20, 1.6, 0, 0), (2, 0.45, 0, 0), (20, 0.8, 0, 0), (12, 0.8, 0, 9), (15, 0.7, 900, 0),
         (9, 3.0, 0, 0), (0, 1.0, 0, 0))


def image_of(stars, sigma_px, hits=0, motion_px=0, seed=0):
    """Return an image of stars on a grid, in electrons."""
    rng = np.random.default_rng(seed)
    light = np.full((SIDE_PX, SIDE_PX), 40.0)
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    grid = np.stack(np.meshgrid(np.arange(20, 180, 32), np.arange(20, 180, 32)), -1).reshape(-1, 2)
    for u, v in grid[:stars] + rng.uniform(-4, 4, (stars, 2)):
        for step in np.linspace(-0.5, 0.5, motion_px + 1) * motion_px:
            light += rng.uniform(0.8, 1) * 4000 / (motion_px + 1) / (
                2 * np.pi * sigma_px ** 2) * np.exp(
                -((x - u - step) ** 2 + (y - v) ** 2) / (2 * sigma_px ** 2))
    image = rng.poisson(light).astype(float)
    u, v = rng.integers(0, SIDE_PX, (2, hits))
    image[v, u] += rng.exponential(800.0, hits)
    return image.clip(0, 65535).astype(np.uint16)


@pytest.fixture(scope='module')
def images():
    return [image_of(*kind) for kind in KINDS]


@pytest.fixture(scope='module')
def results_alone(images):
    return [CentroidExtractor().measure(image) for image in images]


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, len(KINDS) - 1), min_size=2, max_size=6))
def test_an_image_gives_the_same_after_any_others(images, results_alone, order):
    extractor = CentroidExtractor()
    for index in order:
        before = images[index].copy()
        found, alone = extractor.measure(images[index]), results_alone[index]
        np.testing.assert_array_equal(found.centroids.uv, alone.centroids.uv)
        np.testing.assert_array_equal(found.centroids.covariance, alone.centroids.covariance)
        assert found.rejected == alone.rejected and found.psf_sigma_px == alone.psf_sigma_px
        assert found.streak == alone.streak and found.status == alone.status
        np.testing.assert_array_equal(images[index], before)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, len(KINDS) - 1), min_size=1, max_size=5),
       st.integers(0, len(KINDS) - 1))
def test_a_search_depends_on_what_is_passed_in_alone(images, earlier, last):
    """The same state gives the same result, whatever else was extracted in between."""
    extractor, searched = CentroidExtractor(), None
    for index in earlier:
        _, searched = extractor.search(images[index], before=searched)
    first, after_first = extractor.search(images[last], before=searched)
    extractor.search(images[(last + 1) % len(images)], before=searched)
    second, after_second = CentroidExtractor().search(images[last], before=searched)
    np.testing.assert_array_equal(first.centroids.uv, second.centroids.uv)
    assert first.rejected == second.rejected
    assert (after_first is None) == (after_second is None)
    third, fourth = (extractor.search(images[0], before=after)[0] for after in (
        after_first, after_second))
    assert third.psf_sigma_px == fourth.psf_sigma_px


def test_sharp_stars_after_wide_ones_are_not_hits():
    extractor = CentroidExtractor()
    assert len(extractor.measure(image_of(20, 1.6)).centroids) == 20
    assert len(extractor.measure(image_of(2, 0.45)).centroids) == 2


def test_a_width_that_no_image_shows_any_more_is_forgotten():
    extractor, sharp = CentroidExtractor(), image_of(2, 0.45)
    _, searched = extractor.search(image_of(20, 1.6))
    for _ in range(SIGMA_IMAGES):
        few, searched = extractor.search(sharp, before=searched)
        assert few.psf_sigma_px > 1
    assert extractor.search(sharp, before=searched)[0].psf_sigma_px < 1


def test_files_of_a_known_camera_are_solved_alike_in_any_order(sky_data, tmp_path):
    paths = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[::3]
    save_camera(Camera.from_fov(1024, 768, 11.425), tmp_path / 'camera.yaml')

    def solved(files):
        rows = solve_files(files, camera_file=tmp_path / 'camera.yaml', epoch_year=2019.57).rows
        return {row['file']: (row['quaternion'], row['matched'], row['detected']) for row in rows}

    one, other = solved(paths), solved(paths[::-1])
    assert one == other and any(quaternion for quaternion, *_ in one.values())
