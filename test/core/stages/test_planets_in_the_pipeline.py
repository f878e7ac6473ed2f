# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets and the Moon in images: no stars, neither lost in space nor while tracking."""

import numpy as np
import pytest
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, radec_from_unit, rotate
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.sim.sky.bright_bodies import BrightBodyOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

CAMERA, STEP_NS = Camera.from_fov(640, 480, 14.0), 10 ** 8
# A sensor that planets do not saturate, so that they look like stars.
DEEP = DetectorOptions(full_well_e=2e6, gain_e_per_dn=32.0, bit_depth=16)
DISCS = BrightBodyOptions(bright_bodies=True, sun_glare_deg=0.0, moon_glare_deg=0.0,
                          earth_glare_deg=0.0)
# Saturn passed at 54 arcsec from a star of V 5.9, which it hides then.
APPULSE_YEAR, APPULSE_HIP = 2026.05065, 117761


@pytest.fixture(scope='module')
def pipeline():
    return StarTracker(CAMERA, 2026.0)


def frames_at(name, year, off_deg=1.0, detector=DetectorOptions(), discs=BrightBodyOptions()):
    """Return four frames with a body off_deg from the boresight, and their stamps."""
    direction = bodies_from_earth(year).direction[BODIES.index(name)]
    ra_deg, dec_deg = np.degrees(radec_from_unit(direction))
    motion = motion_from_options(MotionOptions(
        motion='inertial', ra_deg=float(ra_deg), dec_deg=float(dec_deg) + off_deg,
        roll_deg=30.0))
    simulator = SkySimulator(CAMERA, motion, load_catalog(), year, detector_options=detector,
                             sky_options=SkyOptions(planets=True), body_options=discs)
    return [(stamp_from_epoch_year(year) + index * STEP_NS, simulator.frame(index * 0.1))
            for index in range(4)]


def assert_only_stars(uv, hip, stars):
    """Whatever has a number is the star of this number."""
    for pixel, number in zip(uv[hip > 0], hip[hip > 0]):
        distance = np.linalg.norm(stars.uv[stars.hip == number] - pixel, axis=1)
        assert distance.min(initial=np.inf) < 2.5, number


def process(pipeline, frames):
    """Process frames; return the last result, after checks of all."""
    pipeline.reset()
    spots = 0
    for stamp_ns, frame in frames:
        centroids = pipeline.extraction.process(
            stamp_ns, frame.image, pipeline.tracker.predicted).centroids
        result = pipeline.process_centroids(stamp_ns, centroids, pipeline.extraction.windowed)
        if result.identification is not None:
            assert result.identification.attitude is not None, result.identification.reason
            assert_only_stars(centroids.uv, result.identification.hip, frame.stars)
            spots += pipeline.identification.body_spots
        assert_only_stars(result.tracks.uv, result.tracks.hip, frame.stars)
    assert result.state is TrackerState.TRACKING and result.attitude is not None
    error = attitude_error(result.attitude.quaternion, frame.q_mean)
    assert np.abs(error[:2]).max() < 10 * ARCSEC
    return result, spots


@pytest.mark.parametrize('name, year, magnitude', [
    ('Venus', 2026.5, -4.1), ('Jupiter', 2026.2, -2.3), ('Saturn', 2026.5, 0.9),
    ('Mars', 2026.5, 1.3), ('Mercury', 2026.5, 2.6), ('Uranus', 2026.5, 5.8)])
def test_a_planet_is_not_a_star_and_has_its_name(pipeline, name, year, magnitude):
    frames = frames_at(name, year, detector=DEEP)
    result, spots = process(pipeline, frames)
    frame = frames[-1][1]
    observer = pipeline.tracker.sky.at(result.stamp_ns).observer
    sky = SkyMapping(CAMERA, result.attitude.quaternion, observer.state)
    seen = {body.name: body for body in Bodies(observer.bodies).in_image(sky)}
    assert seen[name].magnitude == pytest.approx(magnitude, abs=0.15)
    planets = frame.stars.uv[frame.stars.hip == 0]
    assert np.linalg.norm(planets - (seen[name].u, seen[name].v), axis=1).min() < 1
    assert 2 <= spots <= 4 * len(planets)


def test_a_star_that_a_planet_covers_is_not_identified(pipeline):
    frames = frames_at('Saturn', APPULSE_YEAR)
    result, spots = process(pipeline, frames)
    assert spots >= 2 and APPULSE_HIP not in result.tracks.hip
    onboard, sky = pipeline.tracker.sky.onboard, pipeline.tracker.sky.at(result.stamp_ns)
    star = onboard.index_of([APPULSE_HIP])
    assert sky.crowded(star) and not onboard.crowded[star]


def test_the_moon_covers_stars_and_is_not_a_star(pipeline):
    year = 2026.3
    frames = frames_at('Moon', year, 2.0, discs=DISCS)
    frame = frames[0][1]
    moon = bodies_from_earth(year, frame.state.position_m)
    direction, radius_rad = (column[BODIES.index('Moon')] for column in (
        moon.direction, moon.radius_rad))
    uv = CAMERA.project(rotate(frame.state.q_icrf_from_sensor * [-1, -1, -1, 1], direction))
    radius_px = radius_rad / CAMERA.pixel_rad
    row, column = np.indices(frame.image.shape)
    away = np.hypot(column - uv[0], row - uv[1])
    full = 0.98 * frame.image.max()
    assert (frame.image[away < 0.9 * radius_px] > full).all()
    assert np.median(frame.image[(away > 1.3 * radius_px) & (away < 3 * radius_px)]) < full / 10
    assert np.linalg.norm(frame.stars.uv - uv, axis=1).min() > radius_px - 1
    process(pipeline, frames)
