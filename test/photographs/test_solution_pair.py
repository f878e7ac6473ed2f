# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quaternion and camera of a Solution: together they have each matched star at its pixel."""

import numpy as np
import pytest
from startracker_evaluation.campaign.fisheyes import (
    draw_cropped, draw_night, EPOCH_YEAR as NIGHT_YEAR)
import startracker_ros as st
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import (
    angle_between, conjugate, matrix_from_quaternion, rotate, unit_from_radec)
from startracker_ros.io.images.images import read_image
from startracker_ros.photographs.photograph import PhotographSolver

YEAR = 2026.5
# Pixel ratio, centre and distortion of lenses that people have.
LENSES = {
    'narrow': Camera(640, 480, 4000.0, 4000.0, 325.0, 243.0),
    'wide': Camera(800, 600, 900.0, 920.0, 430.0, 280.0, (-0.15, 0.02, 0.0, 0.0, 0.0)),
    'tangential': Camera(800, 600, 1500.0, 1500.0, 380.0, 310.0, (-0.1, 0.0, 1e-3, -2e-3, 0.0)),
    'rational': Camera(800, 600, 1100.0, 1100.0, 420.0, 320.0,
                       (0.1, 0.02, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0), 'rational_polynomial'),
    'fisheye': Camera(1000, 1000, 300.0, 300.0, 520.0, 485.0, (-0.02, 0.003, 0.0, 0.0),
                      'equidistant')}


@pytest.fixture(scope='module')
def night_solver():
    return PhotographSolver(NIGHT_YEAR)


def image_of(camera):
    limit = 5.5 if camera.model.equidistant else 7.5
    sky = st.SkySimulator(camera, YEAR, motion='constant_rate', ra_deg=84.0, dec_deg=5.0,
                          rate_deg_s=(0.0, 0.0, 0.0), faint_limit=limit)
    return sky.frame(0.0).image


def off_px(solution, year, observer_state=None):
    """Return how far each matched star is from its pixel, by quaternion and camera alone."""
    catalog = load_catalog()
    hip = solution.identification.hip
    known = np.isin(hip, catalog.hip)
    order = np.argsort(catalog.hip)
    star = order[np.searchsorted(catalog.hip, hip[known], sorter=order)]
    direction = catalog.directions(year, earth_position_au(year))[star]
    if observer_state is not None:
        direction = apparent_directions(direction, observer_state)
    uv = solution.camera.project(direction @ matrix_from_quaternion(solution.quaternion))
    return np.linalg.norm(uv - solution.centroids.uv[known], axis=1)


def middle(solution):
    """Return the direction of the middle pixel by quaternion and camera."""
    camera = solution.camera
    at = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    return rotate(solution.quaternion, camera.unproject(at))


def pointing(solution):
    return unit_from_radec(*np.radians([solution.ra_deg, solution.dec_deg]))


def check(solution, year, most_px=2.0, observer_state=None):
    assert solution.solved, solution.reason
    off = off_px(solution, year, observer_state)
    assert len(off) >= 6 and np.median(off) < most_px / 3 and off.max() < most_px
    # Pointing and roll are those of the middle of an image whose lens is fitted to it.
    toward = middle(solution) if solution.fitted else rotate(solution.quaternion, [0, 0, 1.0])
    assert angle_between(pointing(solution), toward) < 1e-9
    roll = np.radians(solution.roll_deg)
    ra = np.radians(solution.ra_deg)
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    up = np.cos(roll) * np.cross(pointing(solution), east) + np.sin(roll) * east
    above = solution.camera.project(rotate(conjugate(solution.quaternion), toward + 1e-4 * up))
    here = solution.camera.project(rotate(conjugate(solution.quaternion), toward))
    assert above[1] < here[1] and abs(above[0] - here[0]) < 0.05 * abs(above[1] - here[1])


@pytest.mark.parametrize('name', LENSES)
def test_of_a_calibrated_camera(name):
    solution = st.solve(image_of(LENSES[name]), camera=LENSES[name], epoch=YEAR)
    assert not solution.fitted
    check(solution, YEAR, observer_state=state_near_earth(YEAR, np.zeros(3)))


@pytest.mark.slow
@pytest.mark.parametrize('name', ['narrow', 'wide', 'fisheye'])
def test_of_a_camera_that_is_fitted(name):
    camera = LENSES[name]
    image = image_of(camera)
    for given in (None,) if name == 'fisheye' else (None, np.degrees(camera.seen_x_rad)):
        solution = st.solve(image, given)
        assert solution.fitted
        check(solution, YEAR, 3.0)
        # Its axis is that of the camera where the stars determine it.
        if name != 'narrow':
            assert np.hypot(solution.camera.cx - camera.cx, solution.camera.cy - camera.cy) < 5
        else:
            assert angle_between(rotate(solution.quaternion, [0, 0, 1.0]),
                                 middle(solution)) < 0.01 * camera.pixel_rad


def test_with_aberration_and_a_mosaic_of_colours(sky_data):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[2]
    image = read_image(path)
    year = 2019.57
    solution = st.solve(image, 11.4, year)
    check(solution, year, 2.0, state_near_earth(year, np.zeros(3)))
    mosaic = image.astype(float)
    mosaic[::2, ::2] *= 0.7
    mosaic[1::2, 1::2] *= 0.6
    check(st.solve(mosaic.astype(np.uint16), 11.4, year), year, 3.0,
          state_near_earth(year, np.zeros(3)))


@pytest.mark.slow
@pytest.mark.parametrize('draw, fov_deg', [
    (lambda: draw_cropped(np.random.default_rng(4)), 74.2),
    (lambda: draw_night(np.random.default_rng(11), 'equisolid'), 120.95),
    # Edges of 82 and 91 deg, stars to 65 deg; a margin around the whole sky.
    (lambda: draw_night(np.random.default_rng(6), 'equisolid'), None),
    (lambda: draw_night(np.random.default_rng(5), 'equisolid'), None)])
def test_of_cropped_images_and_fisheyes(night_solver, draw, fov_deg):
    night = draw()
    solution = night_solver.solve_lists([night.centroids], night.shape)
    check(solution, NIGHT_YEAR, 8.0)
    if fov_deg is None:
        assert np.isnan(solution.fov_deg)
    else:
        assert solution.fov_deg == pytest.approx(fov_deg, rel=0.01)
