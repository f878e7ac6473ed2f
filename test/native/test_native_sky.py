# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core reads a sky file as the package does, and no damaged one."""

from directions import unit
from native_core import call, filled
import numpy as np
import pytest
from startracker_ros.core import native
from startracker_ros.core.astro.earth import earth_position_au, earth_state
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.stored_arrays import write_arrays

CAMERA = Camera.from_fov(1024, 1024, 20.0)
YEAR = 2026.0


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp('sky') / 'a.sky'
    with file.open('w+b') as opened:
        write_arrays(opened, sky_arrays(CAMERA, YEAR))
    return file


@pytest.fixture(scope='module')
def sky(path):
    """Return an st_sky, and the bytes that it points to."""
    file = np.memmap(path, np.uint8, 'r')
    return np.array((file.ctypes.data, len(file)), native.SKY), file


@pytest.fixture(scope='module')
def axes():
    return unit(np.random.default_rng(1).normal(size=(60, 3)))


def test_what_is_written_is_accepted(path):
    native.check_sky(path)


def test_stars_in_a_cone_are_those_of_the_tracker(sky, axes):
    stars = camera_stars(CAMERA, YEAR)
    index = np.empty(len(stars), np.int32)
    for axis, radius_rad in zip(axes, np.geomspace(1e-3, 4.0, len(axes))):
        expected = stars.within(axis, radius_rad)
        count = call('stt_stars_in_cone', sky[0], axis, radius_rad, index, len(index))
        assert count == len(expected)
        np.testing.assert_array_equal(index[:count], expected)
        # Of more than fit the brightest are kept.
        some = np.full(11, -1, np.int32)
        assert call('stt_stars_in_cone', sky[0], axis, radius_rad, some, 10) == count
        np.testing.assert_array_equal(some[:min(count, 10)], expected[:10])
        assert some[10] == -1


def test_the_nearest_pattern_star(sky, axes):
    patterns = PyramidIdentifier(CAMERA, YEAR).onboard
    for axis in axes:
        square = np.empty(1)
        away = ((patterns.direction - axis) ** 2).sum(axis=1)
        assert call('stt_nearest_star', sky[0], axis, 0.2, square) == away.argmin()
        assert square[0] == pytest.approx(away.min(), rel=1e-9)
    assert call('stt_nearest_star', sky[0], axes[0], 1e-9, np.empty(1)) == -1


def test_pairs_of_an_interval(sky):
    identifier = PyramidIdentifier(CAMERA, YEAR)
    limits = np.random.default_rng(2).uniform(-0.1, 0.6, (200, 2))
    for bright, pairs in enumerate((identifier.pairs, identifier.bright_pairs)):
        for low, high in [*limits, (0.1, 0.1), (0.0, 4.0), (np.nan, 0.1)]:
            found = np.empty(2, np.int32)
            call('stt_pairs_between', sky[0], bright, float(low), float(high), found)
            first = np.searchsorted(pairs.separation, low)
            end = np.searchsorted(pairs.separation, high, 'right')
            if np.isnan(low):
                first = 0
            assert found[0] == min(first, found[1]) and found[1] == max(found[0], end)


def test_directions_at_another_time(sky):
    at, year = camera_stars(CAMERA, 2026.4), 2026.4
    moved_au = earth_position_au(year) - earth_position_au(YEAR)
    found = np.empty(3)
    for star in range(0, len(at), 500):
        call('stt_direction_at', sky[0], star, year - YEAR, moved_au, found)
        np.testing.assert_allclose(found, at.direction[star], rtol=0, atol=1e-15)


def test_stars_that_have_moved_are_where_they_are_built():
    for year in (2025.6, 2026.4):
        built_then = onboard_catalog(camera_catalog(CAMERA), CAMERA, year)
        moved = camera_stars(CAMERA, year)
        np.testing.assert_array_equal(moved.hip, built_then.hip)
        # The catalogue has proper motions of 24 bits, of stars that have moved for 35 years.
        np.testing.assert_allclose(moved.direction, built_then.direction, rtol=0, atol=2e-10)


def test_the_pattern_stars_are_the_first_ones():
    patterns = PyramidIdentifier(CAMERA, YEAR).onboard
    stars = camera_stars(CAMERA, YEAR)
    for name in ('hip', 'direction', 'magnitude', 'crowded', 'blended'):
        np.testing.assert_array_equal(getattr(stars, name)[:len(patterns)],
                                      getattr(patterns, name))


@pytest.mark.parametrize('year', [1901.3, 1987.6, 2000.0, 2026.25, 2026.9, 2099.1])
def test_the_earth_is_where_parallaxes_need_it(year):
    np.testing.assert_allclose(filled('stt_earth_position_au', (3,), year),
                               earth_state(year)[0], rtol=0, atol=1e-3)
