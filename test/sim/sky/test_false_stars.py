# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets, satellites and aberration, against sources that share nothing with this package."""

from dataclasses import replace

import erfa
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.astro.constants import AU_M
from startracker_ros.core.astro.earth import earth_velocity_m_s
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, conjugate, radec_from_unit, rotate
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

QUIET = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)
YEARS = (2000.0, 2013.3, 2026.4, 2039.9)


def julian_date(year):
    return 2451545.0, (year - 2000) * 365.25


@pytest.mark.parametrize('year', YEARS)
def test_velocity_of_the_earth(year):
    theirs = np.asarray(erfa.epv00(*julian_date(year))[1]['v']) * AU_M / 86400
    assert np.linalg.norm(earth_velocity_m_s(year) - theirs) < 30


def test_aberration_is_that_of_erfa():
    rng = np.random.default_rng(2)
    direction = rng.standard_normal((50, 3))
    direction /= np.linalg.norm(direction, axis=-1)[:, None]
    velocity = np.array([2e7, -1e7, 3e7])
    beta = velocity / 299792458.0
    # Far from the Sun its gravity, which erfa.ab includes, counts for nothing.
    theirs = erfa.ab(direction, beta, 1e12, np.sqrt(1 - beta @ beta))
    np.testing.assert_allclose(aberrate(direction, velocity), theirs, atol=1e-12)


def looking_at(direction, **sky):
    ra_deg, dec_deg = np.degrees(radec_from_unit(direction))
    motion = motion_from_options(MotionOptions(
        motion='inertial', ra_deg=float(ra_deg), dec_deg=float(dec_deg), roll_deg=30.0))
    return motion, lambda options=QUIET, limit=7.0, year=2026.4: SkySimulator(
        CAMERA, motion, load_catalog().brighter_than(limit), year,
        sky_options=SkyOptions(**sky), detector_options=options, seed=5)


def test_a_planet_shines_in_the_image_and_in_the_truth():
    direction, magnitude = bodies_from_earth(2026.4)[:2]
    mars = BODIES.index('Mars')
    motion, simulator = looking_at(direction[mars], planets=True)
    frame = simulator().frame(0.0)
    false = frame.stars.hip == 0
    assert np.count_nonzero(false) >= 1
    nearest = np.argmin(np.linalg.norm(frame.stars.uv - 255.5, axis=-1))
    assert frame.stars.hip[nearest] == 0
    assert frame.stars.magnitude[nearest] == pytest.approx(magnitude[mars])
    theirs = np.asarray(erfa.plan94(*julian_date(2026.4), 4)['p'])
    earth = np.asarray(erfa.epv00(*julian_date(2026.4))[0]['p'])
    uv = CAMERA.project(rotate(conjugate(motion.at(0.0).q_icrf_from_sensor), theirs - earth))
    window = frame.image[250:262, 250:262].astype(float)
    row, column = np.indices(window.shape)
    centre = 250 + np.array([(window * column).sum(), (window * row).sum()]) / window.sum()
    assert np.abs(centre - uv).max() < 120 / 84
    off = looking_at(direction[mars])[1]().frame(0.0)
    assert (off.stars.hip > 0).all()
    assert off.image[250:262, 250:262].sum() < 0.1 * window.sum()


def test_aberration_moves_the_stars_and_not_the_truth_of_the_attitude():
    """30 km/s and 7.5 km/s are 20.5 and 5.2 arcsec, towards where the velocity points."""
    for toward in ([1.0, 0.3, 0.2], [-0.5, 1.0, 0.4], [0.2, -0.6, -0.9]):
        toward = np.array(toward) / np.linalg.norm(toward)
        motion, still = looking_at(toward, aberration=False)
        moving = looking_at(toward, aberration=True)[1]
        before, after = still().frame(3.0), moving().frame(3.0)
        np.testing.assert_array_equal(before.state.q_icrf_from_sensor,
                                      after.state.q_icrf_from_sensor)
        earth = np.asarray(erfa.epv00(*julian_date(2026.4))[1]['v']) * AU_M / 86400
        velocity = earth + motion.at(3.0).velocity_m_s
        common, i, j = np.intersect1d(before.stars.hip, after.stars.hip, return_indices=True)
        q = before.state.q_icrf_from_sensor
        shift = rotate(q, CAMERA.unproject(after.stars.uv[j])
                       - CAMERA.unproject(before.stars.uv[i]))
        across = velocity - (velocity @ toward) * toward
        expected = across / 299792458.0
        # Over 12 deg the shift itself changes with the angle to the velocity.
        assert len(common) > 20
        assert np.linalg.norm(shift.mean(0) - expected) < 0.6 * ARCSEC
        assert np.linalg.norm(shift.mean(0)) < 26.5 * ARCSEC
        assert (before.image != after.image).any()


def satellite(frame):
    [index] = np.flatnonzero(frame.stars.hip == 0)
    return frame.stars.uv[index]


SATELLITE = {'satellites': 1, 'satellite_rate_deg_s': 0.5, 'satellite_magnitude': 2.0}


def seen_twice(simulator, step_s):
    for time_s in np.arange(0.0, 60.0, 1.0):
        frames = [simulator.frame(time_s), simulator.frame(time_s + step_s)]
        if all((frame.stars.hip == 0).sum() == 1 for frame in frames):
            yield frames


def test_a_satellite_moves_at_its_rate_and_on_a_great_circle():
    simulator = looking_at(np.array([0.3, 0.5, -0.4]), **SATELLITE)[1](limit=3.0)
    seen = list(seen_twice(simulator, 0.5))
    assert len(seen) > 20
    directions = [[CAMERA.unproject(satellite(frame)) for frame in frames] for frames in seen]
    for before, after in directions:
        angle = np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after)
        assert np.degrees(angle) == pytest.approx(0.25, rel=1e-6)
    one_pass = np.reshape(directions[:5], (10, 3))
    assert np.linalg.svd(one_pass)[1][-1] < 1e-6


def test_a_satellite_leaves_a_streak_as_long_as_its_motion():
    options = replace(QUIET, motion_smear=True)
    simulator = looking_at(np.array([0.3, 0.5, -0.4]), **SATELLITE)[1](options, limit=-1.0)
    length_px = np.radians(0.5) * 0.1 * CAMERA.fx
    tested = 0
    for frame, _ in seen_twice(simulator, 0.1):
        u, v = np.rint(satellite(frame)).astype(int)
        if not CAMERA.contains(np.array([u, v]), 12):
            continue
        window = frame.image[v - 10:v + 11, u - 10:u + 11].astype(float)
        row, column = np.indices(window.shape)
        uv = np.stack([column.ravel(), row.ravel()])
        variance = np.linalg.eigvalsh(np.cov(uv, aweights=window.ravel(), ddof=0))
        assert variance[0] == pytest.approx(0.64 + 1 / 12, rel=0.02)
        # Off the axis a pixel is a smaller angle, by up to 2 %.
        assert variance[1] == pytest.approx(0.64 + 1 / 12 + length_px ** 2 / 12, rel=0.05)
        assert frame.image.sum() == pytest.approx(frame.flux_dn[-1], rel=0.01)
        tested += 1
    assert tested > 10


def test_one_satellite_follows_the_other():
    simulator = looking_at(np.array([0.3, 0.5, -0.4]), **SATELLITE | {
        'satellites': 3, 'satellite_rate_deg_s': 5.0})[1](limit=-1.0)
    seen = [np.count_nonzero(simulator.frame(t).stars.hip == 0) for t in np.arange(0, 60, 0.5)]
    assert 1 < np.mean(seen) <= 3 and max(seen) == 3
    again = looking_at(np.array([0.3, 0.5, -0.4]), **SATELLITE | {
        'satellites': 3, 'satellite_rate_deg_s': 5.0})[1](limit=-1.0)
    np.testing.assert_array_equal(again.frame(7.5).stars.uv, simulator.frame(7.5).stars.uv)
