# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bright detections without a catalogue star; the Moon from a site."""

import json

import cv2
import numpy as np
import pytest
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.images import read_image
from startracker_ros.io.table import show
from startracker_ros.photographs.arrays import solve
from startracker_ros.photographs.epoch_and_site import ObserverSite
from startracker_ros.photographs.solve import Outputs, solve_files
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

CAMERA, YEAR = Camera.from_fov(1024, 768, 14.0), 2026.5
WIDE = IdentificationOptions(fov_error_percent=5.0)


def frame_at(direction, *, planets):
    """Return an image with a direction (3,) 0.9 deg from its middle."""
    ra_deg, dec_deg = np.degrees(radec_from_unit(direction))
    motion = motion_from_options(MotionOptions(
        motion='inertial', ra_deg=float(ra_deg), dec_deg=float(dec_deg) + 0.9, roll_deg=30.0))
    return SkySimulator(CAMERA, motion, load_catalog(), YEAR,
                        sky_options=SkyOptions(planets=planets)).frame(0.0)


def test_a_planet_is_listed_where_the_time_is_unknown_and_named_where_it_is_known(
        tmp_path, capsys):
    direction = bodies_from_earth(YEAR).direction[BODIES.index('Jupiter')]
    cv2.imwrite(str(tmp_path / 'sky.png'), frame_at(direction, planets=True).image)
    result = solve_files([tmp_path / 'sky.png'], fov_deg=14.0, options=WIDE,
                         outputs=Outputs(tmp_path / 'pictures'))
    row, = result.rows
    assert row['solved'] and row['bodies'] == []
    one, = row['uncatalogued']
    ra_deg, dec_deg = np.degrees(radec_from_unit(direction))
    # Within the error of the positions of planets.
    assert (one['ra_deg'], one['dec_deg']) == pytest.approx((ra_deg % 360, dec_deg), abs=0.02)
    # The flux of a saturated planet is a lower limit.
    assert -3.0 < one['magnitude'] < 4.0
    assert result.conditions['uncatalogued'].startswith('sky.png: 1 brighter than V ')
    show(result, as_json=True)
    assert json.loads(capsys.readouterr().out)['rows'][0]['uncatalogued'] == [one]
    known = solve_files([tmp_path / 'sky.png'], fov_deg=14.0, epoch_year=YEAR, options=WIDE)
    assert 'Jupiter' in [body['name'] for body in known.rows[0]['bodies']]
    assert known.rows[0]['uncatalogued'] == [] and 'uncatalogued' not in known.conditions


def test_a_nova_is_listed_and_stars_are_not(sky_data):
    """Real images, as they are and with a spot that has no star; T Cephei in one is variable."""
    for number, path in enumerate(sorted((sky_data / 'night-sky-11deg').glob('*.png'))):
        image = read_image(path)
        alone = solve(image, 11.4, 2019.57)
        assert alone.solved and alone.uncatalogued == (), path.name
        if number % 4:
            continue
        brightest = alone.centroids.uv[np.argmax(alone.centroids.flux)].round().astype(int)
        spot = image[brightest[1] - 6:brightest[1] + 7, brightest[0] - 6:brightest[0] + 7]
        u, v = 500, 300
        image[v - 6:v + 7, u - 6:u + 7] = np.maximum(image[v - 6:v + 7, u - 6:u + 7], spot)
        seen = solve(image, 11.4, 2019.57)
        nova, = seen.uncatalogued
        assert np.hypot(nova.u - u, nova.v - v) < 1.5
        direction = np.degrees(np.array(radec_from_unit(
            alone.sky.directions(np.array([[nova.u, nova.v]])))))[:, 0]
        np.testing.assert_allclose((nova.ra_deg % 360, nova.dec_deg), direction % 360 * [1, 0]
                                   + [0, direction[1]], atol=0.01)
        stars = alone.stars
        assert nova.magnitude == pytest.approx(
            stars['magnitude'][np.argmax(stars['flux_dn'])], abs=1.0)
        # The picture has a mark more than the circle of a detection.
        assert seen.annotate().shape[0] > alone.annotate().shape[0]


def test_the_moon_is_where_the_site_sees_it(tmp_path):
    site = Site(-30.0, -70.0, 2400.0)
    moon = BODIES.index('Moon')
    seen = bodies_from_earth(YEAR, site.position_m(YEAR))
    centre = bodies_from_earth(YEAR).direction[moon]
    assert np.degrees(np.linalg.norm(seen.direction[moon] - centre)) > 0.2
    frame = frame_at(seen.direction[moon], planets=False)
    image, q = frame.image.copy(), frame.state.q_icrf_from_sensor
    u, v = SkyMapping(CAMERA, q).pixels(seen.direction[moon][None])[0]
    radius = float(seen.radius_rad[moon]) / CAMERA.pixel_rad
    cv2.circle(image, (round(u), round(v)), round(radius), 255, -1)
    cv2.imwrite(str(tmp_path / 'moon.png'), image)
    for where, near in ((ObserverSite(site), True), (ObserverSite(), False)):
        row, = solve_files([tmp_path / 'moon.png'], fov_deg=14.0, epoch_year=YEAR, options=WIDE,
                           observer_site=where).rows
        assert row['solved'], row['reason']
        body = next(one for one in row['bodies'] if one['name'] == 'Moon')
        assert (np.hypot(body['u'] - u, body['v'] - v) < 3) == near
