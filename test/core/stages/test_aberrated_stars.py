# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lenses whose stars are not points: other shapes in each part of the image, or one for all."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.photographs.solve import solve_image
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

EPOCH_YEAR = 2026.5
CAMERA = Camera.from_fov(512, 512, 16.0)
START_NS, STEP_NS = stamp_from_epoch_year(EPOCH_YEAR), 100_000_000
READ_DN, OFFSET_DN = 2.0, 20.0
FAINTEST_DN = 5.0  # of the stars that are drawn: one has a signal to noise ratio below 1
NODES = np.linspace(-0.5, 0.5, 9)
FRAMES = 15


def drawn(uv, flux_dn, line_px, sigma_px, rng, share=np.full(9, 1 / 9)):
    """
    Return an 8 bit image of stars that are lines (N, 2) px with a Gaussian profile.

    Their centres of light are uv (N, 2), the light of each part of a line is share (9,).
    """
    image = np.full((CAMERA.height, CAMERA.width), OFFSET_DN)
    y, x = np.mgrid[-10:11, -10:11]
    for (u, v), flux, line in zip(uv, flux_dn, line_px):
        column, row = int(np.rint(u)), int(np.rint(v))
        if not (10 <= column < CAMERA.width - 10 and 10 <= row < CAMERA.height - 10):
            continue
        for node, part in zip(NODES, share):
            squared = ((x - (u - column) - node * line[0]) ** 2
                       + (y - (v - row) - node * line[1]) ** 2)
            image[row - 10:row + 11, column - 10:column + 11] += (
                flux * part / (2 * np.pi * sigma_px ** 2)
                * np.exp(-squared / (2 * sigma_px ** 2)))
    image = rng.poisson(image) + rng.normal(0, READ_DN, image.shape)
    return image.clip(0, 255).astype(np.uint8)


def of_each_part(uv):
    """Return lines (N, 2) px of 2 to 5 px whose direction changes from part to part."""
    part = np.floor(uv / 64) @ [1, 9]
    angle, length = 2.4 * part, 2 + (1.7 * part) % 3
    return length[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def of_all(uv):
    """Return the lines of an astigmatic lens: sigma 0.7 px across and 1.5 px along v."""
    return np.tile([0.0, np.sqrt(12 * (1.5 ** 2 - 0.7 ** 2))], (len(uv), 1))


def sky(rate_deg_s=(0.0, 0.0, 0.0), ra_deg=80.0, dec_deg=10.0):
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=ra_deg, dec_deg=dec_deg, rate_deg_s=rate_deg_s))
    return SkySimulator(CAMERA, motion, load_catalog(), EPOCH_YEAR,
                        detector_options=DetectorOptions(noise=False), frame_rate_hz=10.0)


def picture(frame, shape, sigma_px, rng):
    seen = 2 * frame.flux_dn > FAINTEST_DN
    uv = frame.stars.uv[seen]
    return drawn(uv, 2 * frame.flux_dn[seen], shape(uv), sigma_px, rng)


def pointings(count):
    rng = np.random.default_rng(7)
    return [(rng.uniform(0, 360), np.degrees(np.arcsin(rng.uniform(-1, 1)))) for _ in range(count)]


def test_the_brightest_stars_are_found_whatever_their_shape():
    found = honest = 0
    rng = np.random.default_rng(1)
    for ra_deg, dec_deg in pointings(6):
        frame = sky(ra_deg=ra_deg, dec_deg=dec_deg).frame(0.0)
        extraction = CentroidExtractor().measure(picture(frame, of_each_part, 0.5, rng))
        assert extraction.streak is None
        inside = ((frame.stars.uv > 12) & (frame.stars.uv < 499)).all(axis=1)
        brightest = np.flatnonzero(inside)[np.argsort(frame.stars.magnitude[inside])[:12]]
        tree = cKDTree(extraction.centroids.uv)
        distance, index = tree.query(frame.stars.uv[brightest])
        found += np.count_nonzero(distance < 2)
        honest += np.count_nonzero(distance < 3.5 * extraction.centroids.sigma_px[index])
    assert found >= 0.95 * 72
    assert honest >= 0.9 * 72


def test_images_of_a_known_camera_are_solved_whatever_the_shape():
    identifier = make_identifier(CAMERA, EPOCH_YEAR)
    catalog = ApparentCatalog(onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR))
    rng, solved = np.random.default_rng(2), 0
    for ra_deg, dec_deg in pointings(6):
        frame = sky(ra_deg=ra_deg, dec_deg=dec_deg).frame(0.0)
        image = picture(frame, of_each_part, 0.5, rng)
        solution = solve_image(image, CentroidExtractor(), identifier, catalog)
        if solution.quaternion is not None:
            solved += 1
            # Without the velocity of the observer, which the simulator adds: up to 26 arcsec.
            error = attitude_error(solution.quaternion, frame.state.q_icrf_from_sensor)
            assert np.degrees(np.linalg.norm(error)) < 0.05
    assert solved == 6


@pytest.mark.slow
@pytest.mark.parametrize('shape, sigma_px, rate_deg_s', [
    (of_each_part, 0.5, (0.0, 0.6, 0.0)), (of_all, 0.7, (0.0, 0.0, 0.0)),
    *(pytest.param(*case, marks=pytest.mark.long) for case in (
        (of_each_part, 0.5, (0.0, 0.0, 0.0)), (of_each_part, 0.5, (0.1, 0.1, 0.0)),
        (of_all, 0.7, (0.0, 0.6, 0.0)), (of_all, 0.7, (0.1, 0.1, 0.0))))])
def test_static_shapes_are_not_motion(shape, sigma_px, rate_deg_s):
    """Available in 95 % of the frames after the two identifications, none beyond 5 sigma."""
    simulator, pipeline = sky(rate_deg_s), StarTracker(CAMERA, EPOCH_YEAR)
    rng, published = np.random.default_rng(3), 0
    for index in range(FRAMES):
        frame = simulator.frame(index / 10)
        stamp_ns = START_NS + index * STEP_NS
        pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
        result = pipeline.process(stamp_ns, picture(frame, shape, sigma_px, rng))
        attitude = result.attitude
        if attitude is None:
            continue
        published += index >= 2
        error = attitude_error(attitude.quaternion, frame.state.q_icrf_from_sensor)
        assert (np.abs(error) < WRONG_SIGMAS * np.sqrt(np.diag(attitude.covariance_sensor))).all()
    assert published >= 0.95 * (FRAMES - 2)


@pytest.mark.slow
def test_ellipses_are_searched_and_measured_in_one_way():
    """Streaks or wide points: an image that was searched as one was measured as the other."""
    bell = np.exp(-0.5 * (6 * NODES) ** 2)
    simulator, rng = sky((0.05, 0.03, 0.0), *pointings(1)[0]), np.random.default_rng(11)
    pipeline, published = StarTracker(CAMERA, EPOCH_YEAR), 0
    for index in range(40):
        frame = simulator.frame(index / 10)
        stamp_ns = START_NS + index * STEP_NS
        pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
        seen = 6 * frame.flux_dn > FAINTEST_DN
        # Sigma 0.7 px across and 1.5 px along: the nodes reach to 3 sigma.
        line_px = np.tile(6 * np.sqrt(1.5 ** 2 - 0.7 ** 2) * np.array([0.92, 0.39]),
                          (np.count_nonzero(seen), 1))
        result = pipeline.process(stamp_ns, drawn(
            frame.stars.uv[seen], 6 * frame.flux_dn[seen], line_px, 0.7, rng, bell / bell.sum()))
        published += index >= 2 and result.attitude is not None
    assert published == 38
