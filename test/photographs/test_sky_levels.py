# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One catalogue has the stars of fields of any width."""

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import CROWD_MAGNITUDES, onboard_catalog
from startracker_ros.core.catalog.sky_grid import stars_near
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.folders import cache_folder
from startracker_ros.core.identify.identification import limit_for
from startracker_ros.photographs.sky_levels import SkyLevels

YEAR, STARS = 2015.0, 30.0
CAMERAS = [Camera.from_fov(1024, 768, fov_deg) for fov_deg in (60.0, 20.0, 8.0)]


def make():
    return SkyLevels(load_catalog, YEAR, CAMERAS, STARS)


@pytest.fixture(scope='module')
def levels():
    return make()


def test_a_level_has_the_bright_stars_and_some_everywhere(levels):
    catalog, asked = load_catalog(), np.random.default_rng(1).standard_normal((200, 3))
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    for number, camera in enumerate(CAMERAS):
        level = levels.level(number)
        star = np.sort(level.grid.member)
        bright = len(catalog.brighter_than(limit_for(camera, catalog, STARS)))
        np.testing.assert_array_equal(star[:bright], np.arange(bright))
        assert len(star) < 2.5 * bright
        # No part of the sky of a third of the field is empty.
        nearest = (asked @ level.direction[star].T).max(1)
        assert np.arccos(nearest.min()) < camera.fov_x_rad / 3


def test_a_level_finds_its_stars_in_the_list_of_all(levels):
    catalog = load_catalog()
    wide, narrow = levels.level(0), levels.level(2)
    assert wide.direction is narrow.direction
    star = np.sort(wide.grid.member)
    np.testing.assert_array_equal(wide.index_of(catalog.hip[star]), star)
    fainter = np.setdiff1d(narrow.grid.member, star)
    assert (wide.index_of(catalog.hip[fainter]) == -1).all()
    np.testing.assert_array_equal(narrow.index_of(catalog.hip[fainter]), fainter)
    assert wide.index_of(np.array([130_000])) == [-1]
    found = stars_near(wide.grid, wide.direction[0], 0.5)
    np.testing.assert_array_equal(
        np.sort(found), star[wide.direction[star] @ wide.direction[0] >= 1 - 0.125])


@pytest.mark.parametrize('number', [0, 2])
def test_the_stars_about_an_image_are_those_of_its_camera(levels, number):
    """As those of the whole sky, except where the circle cuts a part of it."""
    camera, catalog = CAMERAS[number], load_catalog()
    center, radius_rad = np.array([0.6, 0.0, 0.8]), camera.fov_x_rad
    found = levels.about(number, center, radius_rad)
    limit = limit_for(camera, catalog, STARS)
    whole = onboard_catalog(catalog.brighter_than(limit + CROWD_MAGNITUDES), camera, YEAR, limit,
                            STARS / (camera.fov_x_rad * camera.fov_y_rad))
    inside = whole.within(center, 0.8 * radius_rad)
    mine = found.index_of(whole.hip[inside])
    assert len(inside) > 20 and (mine >= 0).all()
    np.testing.assert_allclose(found.direction[mine], whole.direction[inside], atol=1e-12)
    np.testing.assert_allclose(found.magnitude[mine], whole.magnitude[inside], atol=1e-6)
    # The area of a cap.
    assert found.sky_share == pytest.approx((1 - np.cos(radius_rad)) / 2)


def test_a_damaged_file_of_levels_is_built_again(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    member = make().level(1).grid.member.copy()
    file, = cache_folder().glob('levels-*.bin')
    with file.open('r+b') as damaged:
        damaged.seek(-1000, 2)
        damaged.write(b'damage')
    np.testing.assert_array_equal(make().level(1).grid.member, member)
    assert 'damaged' in caplog.text
