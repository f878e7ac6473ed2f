# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion during the exposure and from row to row, measured on the rendered image."""

from dataclasses import replace

import numpy as np
import pytest
from skies import CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.sim.sky.detector import Detector, DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.shake import SwayingMotion
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

QUIET = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0, zero_flux_e_s=2e7)
SMEARED = replace(QUIET, motion_smear=True)
EPOCH_YEAR = 2026.0


def star_at(camera, uv, q):
    """Return a catalogue of stars of V = 5 that attitude q shows at uv (N, 2)."""
    direction = rotate(q, camera.unproject(np.array(uv, float)))
    count = len(direction)
    still = np.zeros(count, np.float32)
    return StarCatalog(np.arange(1, count + 1, dtype=np.int32),
                       np.arctan2(direction[:, 1], direction[:, 0]), np.arcsin(direction[:, 2]),
                       still, still, still, np.full(count, 5.0, np.float32), still,
                       still)


def frame_of(uv, rate_deg_s, options, camera=CAMERA):
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=40.0, dec_deg=-35.0, roll_deg=25.0,
        rate_deg_s=rate_deg_s))
    catalog = star_at(camera, uv, motion.at(0.0).q_icrf_from_sensor)
    return SkySimulator(camera, motion, catalog, EPOCH_YEAR,
                        detector_options=options,
                        sky_options=SkyOptions(aberration=False)).frame(0.0), motion


def moments(image, uv, half=24):
    """Return centre (2,) and covariance (2, 2) of the light around uv."""
    u, v = np.rint(uv).astype(int)
    window = image[v - half:v + half + 1, u - half:u + half + 1].astype(float)
    grid = np.arange(-half, half + 1)
    pixel = np.stack(np.meshgrid(u + grid, v + grid), -1).reshape(-1, 2)
    weight = window.ravel() / window.sum()
    centre = weight @ pixel
    return centre, (pixel - centre).T @ (weight[:, None] * (pixel - centre))


@pytest.mark.parametrize('rate_deg_s, direction', [
    ((0.0, 0.5, 0.0), (1, 0)), ((0.5, 0.0, 0.0), (0, 1)), ((0.3, 0.4, 0.0), (0.8, -0.6)),
    ((0.0, 0.06, 0.0), (1, 0))])
def test_smear_is_as_long_as_the_turn(rate_deg_s, direction):
    """A box of length L adds L^2 / 12 along the motion and nothing across it."""
    frame, _ = frame_of([(511.5, 511.5)], rate_deg_s, SMEARED)
    centre, covariance = moments(frame.image, (511.5, 511.5))
    length_px = np.radians(np.linalg.norm(rate_deg_s)) * 0.1 * CAMERA.fx
    along, across = np.array(direction), np.array([-direction[1], direction[0]])
    assert np.abs(centre - 511.5).max() < 5e-3
    assert along @ covariance @ along == pytest.approx(
        length_px ** 2 / 12 + 0.64 + 1 / 12, rel=5e-3)
    assert across @ covariance @ across == pytest.approx(0.64 + 1 / 12, rel=5e-3)
    still, _ = frame_of([(511.5, 511.5)], rate_deg_s, QUIET)
    assert frame.image.sum() == pytest.approx(still.image.sum(dtype=float), rel=5e-3)
    assert moments(still.image, (511.5, 511.5))[1][0, 0] == pytest.approx(
        0.64 + 1 / 12, rel=5e-3)


def test_roll_draws_arcs_about_the_boresight():
    uv = np.array([(900.0, 511.5), (511.5, 811.5), (511.5, 511.5)])
    frame, _ = frame_of(uv, (0.0, 0.0, 10.0), SMEARED)
    for pixel, across in ((uv[0], 0), (uv[1], 1)):
        covariance = moments(frame.image, pixel, half=50)[1]
        length_px = np.radians(10.0) * 0.1 * np.linalg.norm(pixel - 511.5)
        assert covariance[1 - across, 1 - across] == pytest.approx(
            length_px ** 2 / 12 + 0.64 + 1 / 12, rel=5e-3)
        # The sagitta of an arc of 1 deg is small.
        assert covariance[across, across] < 0.9
    assert moments(frame.image, uv[2])[1].trace() == pytest.approx(2 * (0.64 + 1 / 12), rel=5e-3)


@pytest.mark.parametrize('rate_deg_s', [(0.3, -0.4, 0.0), (0.1, 0.2, 8.0), (0.02, 0.03, -0.1)])
def test_smear_is_the_mean_of_many_short_exposures(rate_deg_s):
    """Against 801 sharp images along the real path, in a distorted camera."""
    camera = Camera(256, 256, 1200.0, 1200.0, 120.0, 131.0, (-0.3, 0.1, 1e-3, -2e-3, 0.0))
    uv = [(40.2, 51.7), (200.4, 60.1), (128.3, 210.6), (127.0, 127.0)]
    frame, motion = frame_of(uv, rate_deg_s, SMEARED, camera)
    directions = rotate(motion.at(0.0).q_icrf_from_sensor, camera.unproject(np.array(uv)))
    count = 801
    uv = np.concatenate([camera.project(rotate(
        conjugate(motion.at(0.1 * t).q_icrf_from_sensor), directions))
        for t in (np.arange(count) + 0.5) / count - 0.5])
    oracle = Detector(camera, QUIET).render(uv, np.full(len(uv), 5.0),
                                            np.random.default_rng(1), 1 / count)
    difference = np.abs(frame.image.astype(float) - oracle)
    assert oracle.max() > 2000 and difference.max() < 2e-3 * oracle.max() + 1


@pytest.mark.parametrize('rate_deg_s', [(0.0, 0.5, 0.0), (0.5, 0.0, 0.0), (-3.0, 2.0, 5.0)])
@pytest.mark.parametrize('smear', [False, True])
def test_rolling_shutter_sees_each_row_at_its_time(rate_deg_s, smear):
    """The centre of light of a star is where the attitude of its row puts it."""
    options = replace(QUIET, line_time_us=30.0, motion_smear=smear, exposure_s=0.02,
                      zero_flux_e_s=1e8)
    uv = np.array([(300.2, 60.7), (700.3, 510.9), (500.7, 960.4)])
    frame, motion = frame_of(uv, rate_deg_s, options)
    directions = rotate(motion.at(0.0).q_icrf_from_sensor, CAMERA.unproject(uv))
    moved = []
    for hip, pixel in zip(frame.stars.hip, frame.stars.uv):
        centre, _ = moments(frame.image, pixel)
        delay_s = (centre[1] - 511.5) * 30e-6
        expected = CAMERA.project(rotate(
            conjugate(motion.at(delay_s).q_icrf_from_sensor), directions[hip - 1]))
        assert np.abs(centre - expected).max() < 0.01
        assert np.abs(pixel - expected).max() < 0.01
        moved.append(np.linalg.norm(centre - uv[hip - 1]))
    assert len(moved) == 3
    # Half a degree a second over the 14 ms to the outer rows is 0.6 px.
    assert max(moved) > 0.5 and moved[1] < 0.05


@pytest.mark.parametrize('period_s', [0.5, 2.0])
def test_rolling_shutter_sees_a_body_that_changes_its_rate(period_s):
    """Within the 82 ms of its rows the rate changes by up to a degree a second."""
    steady = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=40.0, dec_deg=-35.0, roll_deg=25.0,
        rate_deg_s=(0.1, -0.2, 0.3)))
    motion = SwayingMotion(steady, np.array([0.48, 0.64, 0.6]), np.radians(0.1), period_s, 0.3)
    uv = np.array([(300.2, 60.7), (700.3, 510.9), (500.7, 960.4)])
    directions = rotate(motion.at(0.0).q_icrf_from_sensor, CAMERA.unproject(uv))
    simulator = SkySimulator(
        CAMERA, motion, star_at(CAMERA, uv, motion.at(0.0).q_icrf_from_sensor), EPOCH_YEAR,
        detector_options=replace(QUIET, line_time_us=80.0, motion_smear=True, exposure_s=0.001,
                                 zero_flux_e_s=2e9), sky_options=SkyOptions(aberration=False))
    frame = simulator.frame(0.0)
    for hip, pixel in zip(frame.stars.hip, frame.stars.uv):
        state = motion.at((pixel[1] - 511.5) * 80e-6)
        expected = CAMERA.project(rotate(
            conjugate(state.q_icrf_from_sensor), directions[hip - 1]))
        assert np.abs(pixel - expected).max() < 1e-3
        assert np.abs(moments(frame.image, pixel)[0] - expected).max() < 0.01


def test_a_global_shutter_sees_all_rows_at_once():
    uv = np.array([(300.2, 60.7), (500.7, 960.4)])
    frame, _ = frame_of(uv, (0.3, 0.5, 1.0), QUIET)
    for pixel in uv:
        assert np.abs(moments(frame.image, pixel)[0] - pixel).max() < 5e-3


def test_stars_are_rendered_where_the_distorted_lens_has_them():
    distortion = (-0.25, 0.08, 2e-3, -1e-3, 0.0)
    camera = Camera(1024, 1024, 2400.0, 2400.0, 500.0, 520.0, distortion)
    motion = motion_from_options(MotionOptions(motion='inertial'))
    simulator = SkySimulator(camera, motion, load_catalog().brighter_than(5.0), EPOCH_YEAR,
                             detector_options=replace(QUIET, zero_flux_e_s=1e6),
                             sky_options=SkyOptions(aberration=False))
    frame = simulator.frame(0.0)
    pinhole = replace(camera, distortion=(0.0,) * 5)
    bent = tested = 0
    for pixel in frame.stars.uv:
        apart = np.sort(np.linalg.norm(frame.stars.uv - pixel, axis=-1))[1]
        if apart < 24 or not camera.contains(pixel, 12):
            continue
        centre, _ = moments(frame.image, pixel, half=8)
        direction = camera.unproject(centre)
        true = rotate(conjugate(frame.state.q_icrf_from_sensor),
                      load_catalog().directions(EPOCH_YEAR))
        assert np.min(np.linalg.norm(true - direction, axis=-1)) < 0.02 * camera.pixel_rad
        bent = max(bent, np.linalg.norm(pinhole.project(direction) - centre))
        tested += 1
    assert tested > 10 and bent > 3


def test_smeared_stars_come_in_from_outside():
    """A star whose middle is outside the image leaves the part of its streak that is inside."""
    frame, _ = frame_of([(-12.0, 400.0)], (0.0, 3.0, 0.0), SMEARED)
    length_px = np.radians(3.0) * 0.1 * CAMERA.fx
    total = Detector(CAMERA, QUIET).flux_dn(5.0)
    assert len(frame.stars) == 0
    share = frame.image.sum(dtype=float) / total
    assert share == pytest.approx((length_px / 2 - 11.5) / length_px, abs=0.02)


def test_rows_see_what_was_outside_in_the_middle_of_the_exposure():
    """A star beyond the corner at the stamp stands in the image when the first row is read."""
    options = replace(QUIET, line_time_us=100.0)
    # 52 ms before the stamp it was 20 deg/s x 52 ms = 1 deg, 87 px, further to the right.
    frame, motion = frame_of([(-60.0, 20.0)], (0.0, 20.0, 0.0), options)
    [pixel] = frame.stars.uv
    delay_s = (pixel[1] - 511.5) * 100e-6
    direction = rotate(motion.at(0.0).q_icrf_from_sensor,
                       CAMERA.unproject(np.array([(-60.0, 20.0)])))
    expected = CAMERA.project(rotate(
        conjugate(motion.at(delay_s).q_icrf_from_sensor), direction))[0]
    assert np.abs(pixel - expected).max() < 0.01 and 10 < pixel[0] < 60
    assert np.abs(moments(frame.image, pixel, half=9)[0] - expected).max() < 0.01
