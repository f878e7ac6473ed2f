# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The native blind search against a record of the functions in Python that it has replaced.

blind.npz has their inputs and outputs: of skies that are drawn here, and of real photographs.
Those of few stars are of the native search, since its probability counts which spots are bright.
"""

import ctypes
from pathlib import Path

import numpy as np
import pytest
from startracker_ros.core import native
from startracker_ros.core.camera.distortion import EQUIDISTANT, PLUMB_BOB
from startracker_ros.core.camera.model import Camera, native_camera
from startracker_ros.core.catalog.sky_grid import sky_grid, SkyGrid
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.photographs.few_stars import few_stars, image_area
from startracker_ros.photographs.ladder import UncalibratedPyramid
from startracker_ros.photographs.lens_fit import lens_of, SkyAndSpots, stars_in_image
from startracker_ros.photographs.sky_quads import matching_quads, quad_table, quads_of
from startracker_ros.photographs.sky_triangles import sky_triangles
from startracker_ros.photographs.tiled import supports
from startracker_ros.photographs.unknown_lens import UnknownLensIdentifier

RECORD = Path(__file__).parent / 'blind.npz'
ROUNDING = 1e-8


@pytest.fixture(scope='module')
def record():
    with np.load(RECORD) as stored:
        return dict(stored)


def calls(record, name):
    """Yield inputs and outputs of each call of a function."""
    number = 0
    while f'{name}_{number}_in0' in record:
        yield tuple([record[f'{name}_{number}_{part}{k}'] for k in range(
            sum(key.startswith(f'{name}_{number}_{part}') for key in record))]
            for part in ('in', 'out'))
        number += 1
    assert number


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def sky(count, seed):
    return unit(np.random.default_rng(seed).standard_normal((count, 3)))


def camera_of(row):
    """Return the st_camera of a row of size, focal lengths, centre, terms and kind."""
    width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, *_, equidistant, _ = row
    return native_camera(
        (int(width), int(height)), (fx, fy), (cx, cy),
        (k1, k2, k3, k4) if equidistant else (k1, k2, p1, p2, k3),
        EQUIDISTANT if equidistant else PLUMB_BOB)


def check_lens(lens, row, quaternion):
    expected = camera_of(row)
    for name in ('fx_px', 'fy_px', 'cx_px', 'cy_px'):
        assert lens['camera'][name] == pytest.approx(expected[name], rel=ROUNDING)
    np.testing.assert_allclose(lens['camera']['distortion'], expected['distortion'], atol=1e-9)
    np.testing.assert_allclose(lens['quaternion'], quaternion, atol=1e-12)


def test_quads_of_a_sky_and_their_matches(record):
    made = quads_of(sky(300, 5), 20.0, 40.0, 1.0)
    for found, name in zip(made, ('code', 'quad', 'side')):
        np.testing.assert_allclose(found, record[name], atol=1e-6)
    table, rng = quad_table(*made), np.random.default_rng(8)
    for number in range(8):
        across = rng.uniform(-0.5, 0.5, (7, 2)) / 2
        image = unit(np.column_stack([across, np.ones(7)]))
        found = matching_quads(table, image, [0, 5][number % 2], 7, 0.03, 0.5, 2.0, 500)
        for array, name in zip(found, ('image', 'row', 'ratio')):
            np.testing.assert_allclose(array, record[f'match_{number}_{name}'], rtol=1e-10)


def test_support_in_a_catalogue_of_a_folder(record):
    rng, direction = np.random.default_rng(9), sky(60000, 6).astype(np.float32)
    grid = sky_grid(direction.astype(float))
    grid = SkyGrid(direction, *grid[1:])
    for number in range(4):
        near = np.argsort(-(direction @ direction[rng.integers(60000)]))[:12]
        image = unit(direction[near].astype(float) + rng.normal(0, 2e-5, (12, 3)))
        base = np.array([rng.permutation(12)[:4] for _ in range(40)], np.int32)
        star = near[base].astype(np.int32)
        wrong = rng.integers(60000, size=star.shape).astype(np.int32)
        star[20:] = np.where(rng.uniform(size=star[20:].shape) < 0.5, star[20:], wrong[20:])
        np.testing.assert_allclose(
            supports(grid, image, np.full(12, 3e-5), base, star, 3.0, [9.0, 0.0][number % 2]),
            record[f'tiled_{number}_support'], rtol=1e-10)


def test_few_stars_of_photographs(record):
    for (camera, options, uv, flux, sigma_px, limits), found in calls(record, 'few'):
        hip, false_alarm, ratio, quaternion, work_s, residual_px = found
        width, height, *lens, magnitude_limit = camera
        tolerance, most, scale_error = options
        identifier = UncalibratedPyramid(
            Camera(int(width), int(height), *lens), 2015.0, IdentificationOptions(
                fov_error_percent=100 * scale_error, tolerance_sigmas=tolerance,
                max_image_stars=int(most), magnitude_limit=magnitude_limit))
        table = sky_triangles(identifier.onboard, image_area(identifier.camera)).table
        result, spent_s = few_stars(identifier, table, Centroids(
            uv, flux, np.full(len(uv), 50.0), sigma_px), *limits)
        np.testing.assert_array_equal(result.hip, hip)
        np.testing.assert_allclose(result.residual_px, residual_px, atol=1e-6)
        assert result.false_alarm_probability == pytest.approx(false_alarm, rel=1e-6)
        assert result.focal_ratio == pytest.approx(ratio, abs=1e-10)
        assert spent_s == pytest.approx(work_s, rel=1e-6)
        assert np.abs(attitude_error(result.attitude.quaternion, quaternion)).max() < 1e-10


@pytest.mark.parametrize('kind', ['fit_plane', 'fit_fish'])
def test_lenses_of_photographs_are_fitted(record, kind):
    for (lens, q, start, free, icrf, uv, sigma_px), found in calls(record, kind):
        row, quaternion, covariance, error_px = found
        fit = SkyAndSpots(icrf, uv, sigma_px).fitted(
            lens_of(camera_of(lens), q), camera_of(start), free, np.arange(len(uv)))
        check_lens(fit, row, quaternion)
        used = slice(len(free))
        scale = np.sqrt(np.outer(*2 * [covariance.diagonal()]))
        np.testing.assert_allclose(fit['covariance'][used, used] / scale, covariance / scale,
                                   atol=ROUNDING)
        assert fit['error_px'] == pytest.approx(error_px, rel=ROUNDING)


def test_stars_in_the_gates_of_fisheyes(record):
    for (row, q, covariance, error_px, direction, uv), (star,) in calls(record, 'gated'):
        lens, used = lens_of(camera_of(row), q), slice(len(covariance))
        lens['covariance'][used, used] = covariance
        seen = SkyAndSpots(direction, uv, np.ones(len(uv)))
        np.testing.assert_array_equal(
            seen.gated(lens, len(covariance), float(error_px)), star)


def test_stars_in_photographs(record):
    for (row, q, direction), (index, pixel) in calls(record, 'inimage'):
        found = stars_in_image(lens_of(camera_of(row), q), direction)
        np.testing.assert_array_equal(found[0], index)
        np.testing.assert_allclose(found[1], pixel, atol=1e-8)


def test_unknown_lenses_of_photographs_are_grown(record):
    direction = UnknownLensIdentifier(2019.5, lambda: None).onboard.direction
    for (row, free, bright, uv, sigma_px, spot, star, ratio), found in calls(record, 'grown'):
        probability, lens, quaternion, matched = found
        fit, fitted = SkyAndSpots(direction[:int(bright)], uv, sigma_px).grown(
            camera_of(row), free, spot, star, ratio)
        np.testing.assert_array_equal(fitted, matched)
        assert fit['probability'] == pytest.approx(float(probability), rel=1e-6)
        if probability < 1:
            check_lens(fit, lens, quaternion)


def test_wrong_use_has_a_status():
    library, three = native.library(), np.zeros((3, 3))
    wrong, count = np.array([[0, 1, 2, 3]], np.int32), ctypes.c_size_t(0)
    table = np.zeros((), native.QUAD_TABLE)
    status = library.st_match_quads(
        table.ctypes.data, three.ctypes.data, 3, wrong.ctypes.data, 1, 0.01, 0.5, 2.0, None, None,
        None, ctypes.byref(count))
    assert library.st_status_text(status).decode() == library.st_status_text(10).decode()
    assert library.st_fit_lens(None, None, None, None, None, 0) == 1
    seen = SkyAndSpots(three, np.zeros((2, 2)), np.ones(2))
    lens = lens_of(native_camera((10, 10), (9.0, 9.0), (4.5, 4.5), (), PLUMB_BOB),
                   np.array([0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(native.NativeError):
        seen.fitted(lens, lens['camera'], np.ones(8), np.array([0, 3]))
    with pytest.raises(native.NativeError):
        seen.gated(lens, 12, 1.0)
    seen._work = seen._work[:64]
    with pytest.raises(native.NativeError, match='memory'):
        seen.fitted(lens, lens['camera'], np.ones(8), np.array([0, 1]))
