# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The instrument as a whole: replays, truth, the image where the truth says."""

from dataclasses import replace

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

QUIET = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)


def simulator(seed=7, options=DetectorOptions(), limit=9.0, **motion):
    return SkySimulator(CAMERA, motion_from_options(MotionOptions(**motion)),
                        load_catalog().brighter_than(limit), 2026.0,
                        detector_options=options, seed=seed,
                        sky_options=SkyOptions(aberration=False))


def test_a_frame_depends_on_seed_and_time_alone():
    first, second = simulator(), simulator()
    straight = [first.frame(0.1 * i).image for i in range(4)]
    second.gyro(5.0)
    for i in (3, 0, 2):
        np.testing.assert_array_equal(second.frame(0.1 * i).image, straight[i])
    assert (simulator(seed=8).frame(0.0).image != straight[0]).mean() > 0.5
    still = simulator(motion='inertial')
    assert (still.frame(0.0).image != still.frame(0.1).image).mean() > 0.5


def test_gyro_sequences_repeat():
    first, second = simulator(), simulator()
    times = np.arange(20) / 100
    one = [first.gyro(t) for t in times]
    for i, t in enumerate(times):
        second.frame(t)
        np.testing.assert_array_equal(second.gyro(t), one[i])
    # A replay from the start repeats them as well.
    np.testing.assert_array_equal([first.gyro(t) for t in times], one)
    truth = first.frame(0.0).state.rate_rad_s
    assert np.degrees(np.abs(np.mean(one, 0) - truth)).max() < 0.03


def test_stars_of_the_truth_are_in_the_image():
    frame = simulator(options=QUIET, limit=6.0).frame(12.0)
    assert len(frame.stars) == len(frame.flux_dn) > 20
    assert CAMERA.contains(frame.stars.uv).all()
    catalog = load_catalog()
    row = np.array([np.flatnonzero(catalog.hip == hip)[0] for hip in frame.stars.hip])
    sensor = rotate(conjugate(frame.state.q_icrf_from_sensor),
                    catalog.directions(2026.0, earth_position_au(2026.0))[row])
    np.testing.assert_allclose(CAMERA.project(sensor), frame.stars.uv, atol=1e-6)
    tested = 0
    for uv, flux_dn in zip(frame.stars.uv, frame.flux_dn):
        apart = np.linalg.norm(frame.stars.uv - uv, axis=-1)
        if np.sort(apart)[1] < 12 or not CAMERA.contains(uv, 6.0):
            continue
        u, v = np.rint(uv).astype(int)
        window = frame.image[v - 5:v + 6, u - 5:u + 6].astype(float)
        grid = np.arange(-5, 6)
        centre = (u + (window.sum(0) @ grid) / window.sum(),
                  v + (window.sum(1) @ grid) / window.sum())
        if window.max() < 4 * QUIET.full_well_e:
            assert np.abs(centre - uv).max() < 3e-3
            assert window.sum() == pytest.approx(flux_dn, rel=0.01)
            tested += 1
    assert tested > 10


def test_a_larger_sensor_sees_the_same_light():
    """Stars around the image shed the light into it that they shed into a larger one."""
    large = replace(CAMERA, width=576, height=576, cx=CAMERA.cx + 32, cy=CAMERA.cy + 32)
    options = replace(QUIET, psf_sigma_px=2.5)
    small_sky, large_sky = (
        SkySimulator(camera, motion_from_options(), load_catalog(), 2026.0,
                     detector_options=options) for camera in (CAMERA, large))
    around = 0
    for time_s in np.arange(0, 600, 60):
        small, wide = small_sky.frame(time_s), large_sky.frame(time_s)
        # The same sum in another order may round to the next number.
        difference = wide.image[32:-32, 32:-32].astype(int) - small.image
        assert np.abs(difference).max() <= 1 and (difference != 0).mean() < 1e-3
        outside = wide.stars.uv[~np.isin(wide.stars.hip, small.stars.hip)] - 32
        around += CAMERA.contains(outside, -5.0).sum()
    assert around > 50


def test_a_brighter_limit_draws_fewer_stars():
    frame = simulator(options=replace(QUIET, exposure_s=1.0), limit=5.0).frame(0.0)
    assert frame.stars.magnitude.max() <= 5.0
