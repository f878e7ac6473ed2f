# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A target in the simulated sky: where it is drawn, how bright, and when it is hidden."""

from dataclasses import replace

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.maths.rotation import conjugate, radec_from_unit, rotate
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions
from startracker_ros.sim.sky.target import Target, TargetOptions

ORBIT = {'inclination_deg': 30.0, 'node_deg': 40.0}
OPTIONS = TargetOptions(target=True, target_altitude_km=1090.0, target_inclination_deg=30.3,
                        target_node_deg=40.0, target_anomaly_deg=62.0, target_magnitude=5.0)
LIGHT_M_S = 299_792_458.0
EPOCH_YEAR = 2026.2


def simulator(**sky):
    """Return a simulator whose camera looks at the target."""
    motion = motion_from_options(MotionOptions(latitude_deg=60.0, **ORBIT))
    line = Target(OPTIONS, EPOCH_YEAR).at(0.0)[0] - motion.at(0.0).position_m
    ra, dec = np.degrees(radec_from_unit(line))
    motion = motion_from_options(MotionOptions(
        latitude_deg=60.0, ra_deg=float(ra) - 1.0, dec_deg=float(dec) + 1.0, **ORBIT))
    return motion, SkySimulator(CAMERA, motion, load_catalog().brighter_than(6.0), EPOCH_YEAR,
                                sky_options=SkyOptions(**sky), target_options=OPTIONS)


@pytest.mark.parametrize('aberration', [False, True])
def test_target_is_drawn_where_it_is_seen(aberration):
    """By arithmetic of its own, and found again in the image."""
    motion, made = simulator(aberration=aberration)
    time_s = 3.0
    state = motion.at(time_s)
    line = made.target.at(time_s)[0] - state.position_m
    if aberration:
        delay_s = np.linalg.norm(line) / LIGHT_M_S
        line = made.target.at(time_s - delay_s)[0] - state.position_m
    direction = line / np.linalg.norm(line)
    if aberration:
        direction = aberrate(direction[None], state.velocity_m_s)[0]
    place = CAMERA.project(rotate(conjugate(state.q_icrf_from_sensor), direction))
    frame = made.frame(time_s)
    drawn = frame.stars.uv[frame.stars.hip == 0]
    np.testing.assert_allclose(drawn, place[None], atol=1e-4)
    centroids = CentroidExtractor().measure(frame.image).centroids
    assert np.linalg.norm(centroids.uv - place, axis=1).min() < 0.3


def test_target_moves_as_its_drift_says():
    motion, made = simulator()
    before, view, after = (made.target.seen_from(motion.at(time_s), time_s, aberration=False)
                           for time_s in (1.9, 2.0, 2.1))
    np.testing.assert_allclose((after.direction - before.direction) / 0.2, view.drift_rad_s,
                               atol=1e-8)


def test_brightness_by_range_and_phase():
    """At 1000 km and half lit it has its standard magnitude; twice as far it loses 1.5."""
    made = Target(OPTIONS, EPOCH_YEAR)
    motion, _ = simulator()
    state = motion.at(0.0)
    place, velocity = made.at(0.0)

    class Fixed(Target):

        def at(self, time_s):
            return place, velocity

    fixed = Fixed(OPTIONS, EPOCH_YEAR)
    sun = fixed._sun
    across = np.cross(sun, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)

    def magnitude(direction, range_m):
        observer = replace(state, position_m=place - range_m * direction)
        return fixed.seen_from(observer, 0.0, aberration=False).magnitude
    half = magnitude(across, 1e6)
    assert half == pytest.approx(5.0, abs=1e-6)
    assert magnitude(across, 2e6) - half == pytest.approx(5 * np.log10(2), abs=1e-6)
    # Full phase is pi times as bright as half.
    assert half - magnitude(-sun, 1e6) == pytest.approx(2.5 * np.log10(np.pi), abs=1e-6)


def test_hidden_in_the_shadow_and_behind_the_earth():
    motion, made = simulator()
    seen = {time_s: made.target.seen_from(motion.at(time_s), time_s, aberration=False)
            for time_s in range(0, 6400, 100)}
    dark = [time_s for time_s, view in seen.items() if view is None]
    # A third of a low orbit is in the shadow.
    assert 0.2 < len(dark) / len(seen) < 0.45
    far = Target(TargetOptions(target=True, target_anomaly_deg=240.0), EPOCH_YEAR)
    assert far.seen_from(motion.at(0.0), 0.0, aberration=False) is None


def test_navigation_has_the_noise_that_it_tells():
    motion, made = simulator()
    error = np.array([np.concatenate(made.navigation(time_s)) for time_s in np.arange(400.0)])
    truth = np.array([np.concatenate([motion.at(t).position_m, motion.at(t).velocity_m_s])
                      for t in np.arange(400.0)])
    sigma = (error - truth).std(axis=0)
    np.testing.assert_allclose(sigma, [10.0] * 3 + [0.033] * 3, rtol=0.15)
    np.testing.assert_array_equal(made.navigation(7.0)[0], made.navigation(7.0)[0])
