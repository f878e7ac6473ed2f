# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of one all-sky camera through a night have the horizon at the same pixels."""

import numpy as np
import pytest
from startracker_evaluation.campaign.fisheyes import (
    draw_images_of_a_night, EPOCH_YEAR, horizon_px, PROJECTIONS)
from startracker_ros.core.camera.distortion import EQUIDISTANT
from startracker_ros.core.camera.model import Camera, native_camera
from startracker_ros.core.maths.rotation import random_attitude, rotate
from startracker_ros.photographs.lens_fit import (
    camera_of, FISHEYE_TERMS, lens_of, LensError, SkyAndSpots)
from startracker_ros.photographs.photograph import PhotographSolver

IMAGES, HAZIEST = 12, 3
FREE = np.array([10.0, 10.0, 10.0, 0.1, 0.02, 0.06, 0.06, *FISHEYE_TERMS])


@pytest.mark.slow
@pytest.mark.parametrize('projection, draw', [
    ('equidistant', 0), pytest.param('equisolid', 0, marks=pytest.mark.long),
    pytest.param('stereographic', 1, marks=pytest.mark.long),
    pytest.param('orthographic', 0, marks=pytest.mark.long)])
def test_the_horizon_stays_within_two_percent(projection, draw):
    rng = np.random.default_rng([7, draw, len(projection)])
    fisheye, images = draw_images_of_a_night(rng, projection, IMAGES)
    truth, solver, found = float(fisheye.radius_px(np.array(np.pi / 2))), PhotographSolver(
        EPOCH_YEAR), []
    # Behind clouds and haze the stars nearest the horizon are missing.
    for night in sorted(images, key=lambda night: len(night.uv))[:HAZIEST]:
        solution = solver.solve_lists([night.centroids], night.shape)
        if solution.solved and solution.camera.model.equidistant:
            assert night.error_px(solution.sky) < night.centroids.sigma_px[0]
            found.append(horizon_px(solution.camera))
    assert len(found) >= HAZIEST - 1
    assert np.std(found) < 0.02 * truth
    assert np.abs(np.array(found) / truth - 1).max() < 0.03


def fitted(radial, reach_deg, rng, noise_px=0.3, stars=120):
    """Return the lens of stars up to an angle from the axis of r / f = radial(angle)."""
    angle = np.radians(reach_deg) * np.sqrt(rng.uniform(0, 1, stars))
    towards, q = rng.uniform(0, 2 * np.pi, stars), random_attitude(rng)
    sensor = np.stack([np.sin(angle) * np.cos(towards), np.sin(angle) * np.sin(towards),
                       np.cos(angle)], axis=1)
    uv = 499.5 + 300.0 * radial(angle)[:, None] * np.stack(
        [np.cos(towards), np.sin(towards)], axis=1) + rng.normal(0, noise_px, (stars, 2))
    seen = SkyAndSpots(rotate(q, sensor), uv, np.full(stars, noise_px))
    start = native_camera((1000, 1000), (300.0, 300.0), (499.5, 499.5), (0.0,) * 4, EQUIDISTANT)
    lens = lens_of(start, q)
    for _ in range(3):
        lens = seen.fitted(lens, start, FREE, np.arange(stars))
    return lens


@pytest.mark.parametrize('projection', ['equidistant', 'equisolid', 'stereographic',
                                        'orthographic'])
def test_stars_to_fifty_degrees_lead_to_eighty(projection):
    rng, farther = np.random.default_rng(3), np.radians(80.0)
    radial = PROJECTIONS[projection](rng)
    truth, off, sigmas = 300.0 * radial(np.array(farther)), [], []
    edge = 499.5 + np.array([[truth, 0.0]])
    for _ in range(20):
        lens = fitted(radial, 50.0, rng)
        camera = camera_of(lens, EQUIDISTANT)
        u, _ = camera.project(np.array([np.sin(farther), 0.0, np.cos(farther)]))
        off.append((u - camera.cx) / truth - 1)
        sigmas.append(LensError(camera, lens['covariance']).sigma_px(edge)[0] / truth)
    assert np.sqrt(np.mean(np.square(off))) < 0.007
    # Most of it are deviations of real lenses, which these do not have.
    assert 0.005 < np.nanmedian(sigmas) < 0.03


def test_the_error_of_an_angle_grows_beyond_the_stars():
    rng = np.random.default_rng(4)
    lens = fitted(PROJECTIONS['equisolid'](rng), 50.0, rng)
    camera = camera_of(lens, EQUIDISTANT)
    error = LensError(camera, lens['covariance'])
    angles = np.radians([20.0, 45.0, 60.0, 75.0])
    uv = camera.project(np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    relative = error.relative(uv)
    assert relative[:2].max() < 0.001 and relative[1] < relative[2] < relative[3]
    assert relative[3] > 0.005
    assert np.isnan(error.relative(np.array([[9e3, 499.5]]))).all()
    # That of a rectilinear lens that is known exactly is zero.
    exact = LensError(Camera(1000, 1000, 900.0, 900.0, 499.5, 499.5), np.zeros((8, 8)))
    assert (exact.sigma_px(np.array([[0.0, 0.0], [999.0, 40.0]])) == 0).all()
