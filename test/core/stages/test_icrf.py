# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitudes in ICRF of a moving observer: bias, covariance, and the modes of aberration."""

from dataclasses import replace

import numpy as np
import pytest
from skies import CAMERA, onboard_stars
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.astro.epoch import catalogue_epoch, stamp_from_epoch_year
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.astro.observer_motion import AberrationOptions, AT_REST, observer_at
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.astro.state import State
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, quaternion_from_pointing, radec_from_unit, random_attitude)
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

YEAR = 2026.4
START_NS, STEP_NS = stamp_from_epoch_year(YEAR), 10 ** 8
ONBOARD = onboard_stars(CAMERA, YEAR)
BRIGHT = onboard_stars(CAMERA, YEAR, 6.5)


def sky_of(velocity_m_s):
    observer_state = state_near_earth(YEAR, velocity_m_s)
    return replace(BRIGHT, direction=apparent_directions(BRIGHT.direction, observer_state))


def pipeline_of(mode):
    return StarTracker(CAMERA, YEAR, aberration=mode)


@pytest.fixture(scope='module')
def pipelines():
    """Return pipelines by mode; one of full has no odometry."""
    return {'without': pipeline_of('full'), 'late': pipeline_of('full'),
            **{mode: pipeline_of(mode) for mode in ('full', 'earth_only', 'none')}}


def run(pipeline, q, state, sigma_px=0.01, frames=4, odometry=True, seed=1, start_ns=START_NS,
        sky=None):
    """Return the last frame of a camera at rest, and the identified one."""
    rng, sky = np.random.default_rng(seed), sky or sky_of(state.velocity_m_s)
    pipeline.reset()
    identified = None
    for index in range(frames):
        stamp_ns = start_ns + index * STEP_NS
        if odometry:
            pipeline.motion.add_state(stamp_ns, state)
        frame = pipeline.process_centroids(stamp_ns, star_list(sky, CAMERA, q, sigma_px, rng)[0])
        identified = frame.identification or identified
    return frame, identified


def states(count, seed=2):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        radius_m = rng.uniform(6.6e6, 4.2e7)
        yield random_attitude(rng), State(*CircularOrbit(
            radius_m, *rng.uniform(0, np.pi, 3)).at(0.0), np.zeros((3, 3)))


def test_attitudes_of_tracker_and_of_single_frames_are_in_icrf(pipelines):
    """At a noise of a milli-pixel nothing but the correction is left."""
    errors = []
    for q, state in states(12):
        frame, identified = run(pipelines['full'], q, state, sigma_px=1e-3)
        errors.append([attitude_error(found.quaternion, q) for found in (
            frame.tracked.attitude, frame.attitude, identified.attitude)])
        # The focal length of this camera is exact.
        assert abs(identified.focal_ratio - 1) < 3e-6
    across = np.hypot(*np.moveaxis(np.array(errors)[..., :2], -1, 0)) / ARCSEC
    assert across.max() < 0.03 and np.median(across) < 0.015


def test_without_odometry_the_covariance_contains_the_orbit(pipelines):
    for mode, odometry in (('without', False), ('earth_only', True)):
        normalised = []
        for seed, (q, state) in enumerate(states(25, seed=3)):
            frame, identified = run(
                pipelines[mode], q, state, odometry=odometry, frames=3, seed=seed)
            for found in (frame.attitude, identified.attitude):
                error = attitude_error(found.quaternion, q)
                assert (np.abs(error) < 3 * np.sqrt(np.diag(found.covariance_sensor))).all()
                normalised.append(error @ np.linalg.solve(found.covariance_sensor, error))
        # Less than 3 of a Gaussian: the speed is not that of the lowest orbit everywhere.
        # The two of a frame have their error in common.
        low, high = mean_chi_square_bounds(3, len(normalised) // 2)
        assert low / 3 < np.mean(normalised) < high, (low / 3, np.mean(normalised), high)


def within(found, q):
    """Return whether an attitude is within 5 sigma, and its errors (3,) over sigma."""
    ratio = attitude_error(found.quaternion, q) / np.sqrt(np.diag(found.covariance_sensor))
    return bool((np.abs(ratio) < 5).all()), ratio


@pytest.mark.parametrize('start_ns', [0, 100 * 10 ** 9, START_NS - 315_964_782 * 10 ** 9])
def test_stamps_without_a_date_have_a_covariance_that_holds(start_ns):
    """Since boot, and GPS time that a catalogue of today contradicts."""
    pipeline, ratios = pipeline_of('full'), []
    for seed, (q, state) in enumerate(states(25, seed=4)):
        frame, identified = run(pipeline, q, state, seed=seed, start_ns=start_ns)
        error = np.abs(attitude_error(frame.attitude.quaternion, q))
        assert (error < frame.attitude.protection_rad).all(), (error, frame.attitude)
        for found in (frame.attitude, frame.tracked.attitude, identified.attitude):
            holds, ratio = within(found, q)
            assert holds, ratio
        ratios.append(within(frame.attitude, q)[1])
        assert frame.aberration.startswith('none (stamps of ')
    # The velocity of the Earth is 1.7 sigma of an axis: no larger than it has to be.
    assert 0.3 < np.mean(np.square(ratios)[:, :2]) < 1.5


def test_stars_of_an_unknown_date_have_moved_by_less_than_the_covariance_says():
    """A sky without aberration of 2050, catalogue of an unknown date."""
    pipeline = StarTracker.with_options(CAMERA, catalogue_epoch(1), StarTrackerOptions(
        aberration=AberrationOptions(aberration='none')))
    moved, worst = onboard_stars(CAMERA, 2050.0, 6.5), 0.0
    for seed, (q, state) in enumerate(states(12, seed=5)):
        frame, identified = run(
            pipeline, q, state, sigma_px=1e-3, odometry=False, seed=seed, start_ns=1, sky=moved)
        for found in (frame.attitude, identified.attitude):
            holds, ratio = within(found, q)
            assert holds, ratio
        error = np.abs(attitude_error(frame.attitude.quaternion, q))
        assert (error < frame.attitude.protection_rad).all()
        worst = max(worst, error.max() / ARCSEC)
    assert worst > 1


def test_none_is_off_by_all_of_the_aberration(pipelines):
    off = [np.linalg.norm(attitude_error(
        run(pipelines['none'], q, state)[0].attitude.quaternion, q)) / ARCSEC
        for q, state in states(12)]
    assert 15 < max(off) < 26


def test_odometry_that_comes_late_does_not_lose_the_stars(pipelines):
    """The change of all directions by 5 arcsec is followed."""
    pipeline, (q, state) = pipelines['late'], next(states(1, seed=8))
    rng, sky = np.random.default_rng(1), sky_of(state.velocity_m_s)
    run(pipeline, q, state, frames=5, odometry=False, sigma_px=0.1)
    for index in range(5, 40):
        stamp_ns = START_NS + index * STEP_NS
        pipeline.motion.add_state(stamp_ns, state)
        frame = pipeline.process_centroids(stamp_ns, star_list(sky, CAMERA, q, 0.1, rng)[0])
        assert frame.attitude is not None, frame.reason
        error = attitude_error(frame.attitude.quaternion, q)
        sigma = np.sqrt(np.diag(frame.attitude.covariance_sensor))
        assert np.abs(error / sigma).max() < 6, index


def test_directions_are_computed_anew_when_the_velocity_has_changed():
    sky = ApparentCatalog(ONBOARD)
    star = np.arange(5)
    np.testing.assert_array_equal(sky.direction(star), ONBOARD.direction[:5])
    for velocity in ([7e3, 0.0, 0.0], [7e3, 1.0, 0.0], [0.0, 7e3, 0.0], None):
        observer = observer_at(YEAR, None if velocity is None else np.array(velocity))
        sky = sky.seen_by(observer)
        expected = apparent_directions(ONBOARD.direction[:5], observer.state)
        assert np.abs(sky.direction(star) - expected).max() < 0.0011 * ARCSEC
    moved, sky = sky, sky.seen_by(AT_REST)
    np.testing.assert_array_equal(sky.direction(star), ONBOARD.direction[:5])
    # Each stays as it is, whatever another observer sees.
    np.testing.assert_array_equal(
        moved.direction(star), apparent_directions(ONBOARD.direction[:5], observer.state))


def test_a_camera_on_the_ground_is_solved_with_refraction():
    """At 40 deg of elevation refraction is 70 arcsec, and 4 arcsec different across the field."""
    site = Site(48.0, 11.5, 500.0)
    observer = observer_at(YEAR, site.velocity_m_s(YEAR), site.air(YEAR))
    sky = replace(BRIGHT, direction=apparent_directions(BRIGHT.direction, observer.state))
    zenith = site.zenith(YEAR)
    side = np.cross(zenith, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    boresight = np.sin(np.radians(40)) * zenith + np.cos(np.radians(40)) * side
    q = quaternion_from_pointing(*radec_from_unit(boresight), 0.3)
    seen, _ = star_list(sky, CAMERA, q, 1e-3, np.random.default_rng(1))
    identifier = make_identifier(CAMERA, YEAR, IdentificationOptions())
    found = identifier.identify(seen)
    errors = []
    for used in (observer, observer_at(YEAR, site.velocity_m_s(YEAR)), AT_REST):
        apparent = ApparentCatalog(ONBOARD, used)
        solved = icrf_identification(found, seen, CAMERA, apparent, identifier.options)
        errors.append(np.linalg.norm(attitude_error(solved.attitude.quaternion, q)) / ARCSEC)
        residual_arcsec = np.sqrt(np.mean(solved.attitude.residual_rad ** 2)) / ARCSEC
        if used is observer:
            assert abs(solved.focal_ratio - 1) < 3e-6 and residual_arcsec < 0.3
    assert errors[0] < 0.2 and errors[1] > 60 and errors[2] > 50
