# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vibration and kicks within an exposure: the motion, the images and their truth."""

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

TURN = {'motion': 'constant_rate', 'rate_deg_s': (0.1, -0.2, 0.05), 'dec_deg': 20.0}
CAMERA = Camera.from_fov(256, 256, 6.0)
CATALOG = load_catalog().brighter_than(7.0)


def motion(seed=3, **shake):
    return motion_from_options(MotionOptions(**TURN, **shake), seed=seed)


def away_arcsec(shaken, time_s):
    """Return the turn (3,) from the steady motion in arcsec about sensor axes."""
    return attitude_error(shaken.at(time_s).q_icrf_from_sensor,
                          motion().at(time_s).q_icrf_from_sensor) / ARCSEC


def test_vibration_is_a_sine_and_its_rate_the_derivative():
    shaken = motion(vibration_arcsec=100.0, vibration_hz=7.0)
    away = np.array([away_arcsec(shaken, k / 700) for k in range(100)])
    assert np.hypot(*away[:, :2].T).max() == pytest.approx(100, abs=0.3)
    assert np.abs(away[:50] + away[50:]).max() < 0.5
    assert np.abs(away[:, 2]).max() < 1e-6
    turned = attitude_error(shaken.at(0.301).q_icrf_from_sensor,
                            shaken.at(0.299).q_icrf_from_sensor)
    np.testing.assert_allclose(turned / 0.002, shaken.at(0.3).rate_rad_s, rtol=2e-3, atol=1e-6)


def test_kicks_come_once_in_a_period_and_every_second_one_leads_back():
    shaken = motion(kick_arcsec=60.0, kick_period_s=0.2)
    away = np.array([away_arcsec(shaken, k / 1000)[:2] for k in range(2000)])
    distance = np.hypot(*away.T)
    assert np.all((distance < 1e-6) | (np.abs(distance - 60) < 0.01))
    jumps = np.flatnonzero(np.hypot(*np.diff(away, axis=0).T) > 1)
    np.testing.assert_array_equal(np.sort(jumps // 200), np.arange(10))
    angle = np.arctan2(*away[jumps[::2] + 1].T)
    assert np.ptp(angle) > 0.5
    other = motion(seed=4, kick_arcsec=60.0, kick_period_s=0.2)
    assert any(away_arcsec(other, k / 100)[0] != away_arcsec(shaken, k / 100)[0]
               for k in range(100))


def frames(count=6, smear=True, **shake):
    simulator = SkySimulator(
        CAMERA, motion(**shake), CATALOG, 2026.5,
        detector_options=DetectorOptions(motion_smear=smear, noise=False, psf_sigma_px=1.0))
    return [simulator.frame(0.1 * (k + 1)) for k in range(count)]


@pytest.mark.parametrize('shake', [{'kick_arcsec': 200.0}, {'vibration_arcsec': 100.0}])
def test_the_mean_light_of_stars_is_that_of_the_mean_pointing(shake):
    """The steady motion has an image as well: light moves by the mean of the shake."""
    for shaken, steady in zip(frames(**shake), frames()):
        shift_px = []
        for uv in steady.stars.uv:
            u, v = uv.round().astype(int)
            near = np.abs(steady.stars.uv - uv).max(axis=1) < 12
            if min(u, v) < 12 or max(u, v) > 243 or near.sum() > 1:
                continue
            box = np.s_[v - 10:v + 11, u - 10:u + 11]
            offset = np.arange(-10, 11)
            means = []
            for image in (shaken.image, steady.image):
                light = image[box].astype(float) - np.median(image)
                means.append([(light.sum(axis=0) @ offset) / light.sum(),
                              (light.sum(axis=1) @ offset) / light.sum()])
            if light.sum() > 300:
                shift_px.append(np.subtract(*means))
        turn = attitude_error(shaken.q_mean, steady.q_mean)
        expected = np.array([-turn[1], turn[0]]) * CAMERA.fx
        assert len(shift_px) >= 3
        np.testing.assert_allclose(np.median(shift_px, axis=0), expected, atol=0.12)


def test_truth_has_the_shake_and_needs_an_image_of_it():
    kicked = frames(20, kick_arcsec=200.0)
    rms = np.array([frame.artefacts.shaking.rms_rad for frame in kicked]) / ARCSEC
    assert rms.max() > 60 and rms.max() <= 100.1 and rms.min() == 0
    counts = kicked[int(rms.argmax())].artefacts.counts()
    assert counts['pointing_rms_arcsec'] == pytest.approx(rms.max())
    assert np.hypot(counts['mean_pointing_x_arcsec'], counts['mean_pointing_y_arcsec']) > 1
    for frame in [*frames(3), *frames(3, smear=False, kick_arcsec=200.0)]:
        assert frame.artefacts.shaking.rms_rad == 0
        np.testing.assert_allclose(frame.q_mean, frame.state.q_icrf_from_sensor, atol=1e-15)


def test_a_rolling_shutter_of_a_shaken_motion_is_rejected():
    with pytest.raises(ValueError, match='line_time_us'):
        SkySimulator(CAMERA, motion(kick_arcsec=10.0), CATALOG, 2026.5,
                     detector_options=DetectorOptions(line_time_us=10.0))
