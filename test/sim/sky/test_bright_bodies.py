# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sun, Moon and Earth in simulated images: where they are, what they fill, what they hide."""

import numpy as np
import pytest
from startracker_ros.core.astro.bodies import bright_bodies
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_axes, rotate
from startracker_ros.sim.sky.bright_bodies import BrightBodies, BrightBodyOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(256, 256, 12.0)
YEAR, FULL_E = 2026.5, 15000.0
# With Sun and Moon above the horizon.
POSITION = 7.0e6 * np.array([0.98, 0.2, 0.0])
VELOCITY = np.array([6.5e3, 0.0, 3.7e3])
ON = BrightBodyOptions(bright_bodies=True, sun_glare_deg=20.0, moon_glare_deg=0.0,
                       earth_glare_deg=10.0)


def state(name, limb_deg):
    """Return a head whose boresight is so far from the limb of a body."""
    direction, radius_rad = bright_bodies(YEAR, POSITION)[name]
    side = np.cross(direction, [0.3, 0.2, 0.9])
    side /= np.linalg.norm(side)
    angle = radius_rad + np.radians(limb_deg)
    boresight = np.cos(angle) * direction + np.sin(angle) * side
    return MotionState(quaternion_from_axes(boresight, np.array([0.1, 0.7, 0.2])), np.zeros(3),
                       POSITION, VELOCITY)


def light(name, limb_deg, options=ON):
    return BrightBodies(CAMERA, options, FULL_E).light(YEAR, state(name, limb_deg))


def pixel(name, at):
    direction, _ = bright_bodies(YEAR, POSITION)[name]
    return CAMERA.project(rotate(conjugate(at.q_icrf_from_sensor), direction)[None])[0]


@pytest.mark.parametrize('name, glare_deg', [('Sun', 20.0), ('Earth', 10.0)])
def test_glare_fills_the_pixels_within_its_angle_and_fades_outside(name, glare_deg):
    at = light(name, glare_deg).light_e
    assert at.max() == pytest.approx(FULL_E, rel=1e-6)
    # Brightest towards the body.
    towards = rotate(conjugate(state(name, glare_deg).q_icrf_from_sensor),
                     bright_bodies(YEAR, POSITION)[name][0])
    row, column = np.unravel_index(np.argmax(at), at.shape)
    assert np.sign([column - 127.5, row - 127.5]) @ np.sign(towards[:2]) == 2
    assert light(name, glare_deg + 1.0).light_e.max() == pytest.approx(FULL_E * np.exp(-2))
    assert light(name, glare_deg - 2.0).light_e.min() > FULL_E
    assert light(name, glare_deg + 10.0) is None


def test_the_moon_is_a_disc_at_its_place_that_hides_stars():
    at = state('Moon', 2.0)
    found = light('Moon', 2.0)
    u, v = np.rint(pixel('Moon', at)).astype(int)
    assert found.light_e[v, u] > 5 * FULL_E and found.clear[v, u] < 1e-3
    full = np.argwhere(found.light_e > FULL_E)
    np.testing.assert_allclose(full.mean(axis=0), [v, u], atol=1.0)
    radius_px = np.sqrt(len(full) / np.pi)
    assert radius_px * np.degrees(CAMERA.pixel_rad) == pytest.approx(0.26, rel=0.1)
    assert light('Moon', 9.0) is None


def test_a_sun_behind_the_earth_sheds_no_light():
    sun = bright_bodies(YEAR)['Sun'][0]
    at = MotionState(quaternion_from_axes(sun, np.array([0.1, 0.7, 0.2])), np.zeros(3),
                     -8.0e6 * sun, VELOCITY)
    only_sun = BrightBodyOptions(bright_bodies=True, earth_glare_deg=0.0, moon_glare_deg=0.0)
    camera = BrightBodies(CAMERA, only_sun, FULL_E)
    assert camera.light(YEAR, at).clear.max() < 1e-3  # the disc of the Earth
    night = MotionState(quaternion_from_axes(np.roll(sun, 1), sun), np.zeros(3), -8.0e6 * sun,
                        VELOCITY)
    assert camera.light(YEAR, night) is None


def test_a_blinded_image_is_full_and_others_are_what_they_were():
    def frame(at, options):
        class Fixed:

            def at(self, time_s):
                return at
        return SkySimulator(CAMERA, Fixed(), load_catalog().brighter_than(6.0), YEAR,
                            body_options=options, seed=3).frame(0.0).image
    full = DetectorOptions().full_well_e / DetectorOptions().gain_e_per_dn
    assert np.median(frame(state('Earth', 5.0), ON)) >= full
    free = state('Sun', 90.0)
    np.testing.assert_array_equal(frame(free, ON), frame(free, BrightBodyOptions()))
