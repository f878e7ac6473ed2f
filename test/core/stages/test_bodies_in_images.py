# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets in photographs: named, and no stars."""

import json

import cv2
import numpy as np
from PIL import Image
import pytest
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth, BodiesInSky
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.names import STAR_NAMES
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, quaternion_from_pointing, radec_from_unit)
from startracker_ros.core.stages.annotate import annotate, Labels
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.io.images.images import read_image
from startracker_ros.io.table import Result, show
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.picture import annotated
from startracker_ros.photographs.sky_marks import compass
from startracker_ros.photographs.solve import Outputs, solve_files
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

CAMERA, YEAR = Camera.from_fov(1024, 768, 14.0), 2026.5
ERROR_RAD = np.array([60 * ARCSEC])
WIDE = IdentificationOptions(fov_error_percent=5.0)


@pytest.fixture(scope='module')
def jupiter(tmp_path_factory):
    """Return an image file with Jupiter 0.9 deg from its middle."""
    direction = bodies_from_earth(YEAR).direction[BODIES.index('Jupiter')]
    ra_deg, dec_deg = np.degrees(radec_from_unit(direction))
    motion = motion_from_options(MotionOptions(
        motion='inertial', ra_deg=float(ra_deg), dec_deg=float(dec_deg) + 0.9, roll_deg=30.0))
    frame = SkySimulator(CAMERA, motion, load_catalog(), YEAR,
                         sky_options=SkyOptions(planets=True)).frame(0.0)
    path = tmp_path_factory.mktemp('jupiter') / 'jupiter.png'
    cv2.imwrite(str(path), frame.image)
    return path


@pytest.mark.parametrize('calibrated', [False, True])
def test_a_planet_is_named(jupiter, tmp_path, calibrated, capsys):
    camera = {'fov_deg': 14.2, 'options': WIDE}
    if calibrated:
        save_camera(CAMERA, tmp_path / 'camera.yaml')
        camera = {'camera_file': tmp_path / 'camera.yaml'}
    result = solve_files([jupiter], epoch_year=YEAR, outputs=Outputs(tmp_path), **camera)
    row, = result.rows
    assert row['solved'], row['reason']
    names = [body['name'] for body in row['bodies']]
    body = row['bodies'][names.index('Jupiter')]
    image = cv2.imread(str(jupiter), cv2.IMREAD_UNCHANGED).astype(float)
    v, u = np.unravel_index(cv2.GaussianBlur(image, (0, 0), 2).argmax(), image.shape)
    assert np.hypot(body['u'] - u, body['v'] - v) < 3
    assert -3 < body['magnitude'] < -1
    show(Result('solve', [row]), as_json=True)
    printed, = json.loads(capsys.readouterr().out)['rows']
    assert printed['bodies'][names.index('Jupiter')] == body
    assert (tmp_path / 'jupiter.png').exists()


def test_without_the_hour_no_body_is_named(jupiter, tmp_path):
    """A planet moves by up to half a degree in the hours between two time zones."""
    with Image.open(jupiter) as picture:
        for name, details in (('zone.png', {0x9011: '+00:00'}), ('none.png', {})):
            exif = Image.Exif()
            exif[0x0112] = 1
            exif[0x8769] = {0x9003: '2026:07:02 15:00:00', **details}
            picture.save(tmp_path / name, exif=exif)
    zone, none, today = solve_files([tmp_path / 'zone.png', tmp_path / 'none.png', jupiter],
                                    fov_deg=14.0).rows
    assert zone['solved'] and 'Jupiter' in [body['name'] for body in zone['bodies']]
    assert none['solved'] and today['solved'] and none['bodies'] == today['bodies'] == []


def test_a_planet_beside_a_star_is_not_that_star(sky_data):
    """The brightest star of an image, as if it were a planet that outshines one."""
    image = read_image(sorted((sky_data / 'night-sky-11deg').glob('*.png'))[3])
    solver, camera = PhotographSolver(2019.57, WIDE), Camera.from_fov(1024, 768, 11.4)
    alone = solver.solve(image, camera)
    star = int(np.flatnonzero(alone.identification.hip)[0])
    direction = alone.sky.directions(alone.centroids.uv[star:star + 1])
    planet = Bodies(BodiesInSky(direction, np.array([1.0]), np.array([1e-5]), ERROR_RAD))
    solution = solver.solve(image, camera, bodies=planet)
    body, = solution.bodies
    np.testing.assert_allclose((body.u, body.v), alone.centroids.uv[star], atol=0.1)
    assert alone.identification.hip[star] not in solution.identification.hip
    assert solution.identification.matched >= 0.8 * alone.identification.matched - 1
    assert np.abs(attitude_error(solution.quaternion, alone.quaternion)[:2]).max() < 10 * ARCSEC
    # One that is much fainter than the star is hidden by it.
    faint = Bodies(BodiesInSky(direction, np.array([9.0]), np.array([1e-5]), ERROR_RAD))
    solution = solver.solve(image, camera, bodies=faint)
    np.testing.assert_array_equal(solution.identification.hip, alone.identification.hip)


@pytest.mark.parametrize('roll_deg', [0.0, 90.0, 200.0])
def test_north_and_east(roll_deg):
    """Roll is the position angle of image up; east is left where north is up."""
    sky = SkyMapping(CAMERA, quaternion_from_pointing(1.0, -0.5, np.radians(roll_deg)))
    ways = compass(sky, np.array([511.5, 383.5]))
    sine, cosine = np.sin(np.radians(roll_deg)), np.cos(np.radians(roll_deg))
    np.testing.assert_allclose(ways['N'], [sine, -cosine], atol=1e-6)
    np.testing.assert_allclose(ways['E'], [-cosine, -sine], atol=1e-6)


def test_named_stars_that_are_not_identified_are_in_the_picture():
    """The belt of Orion, in an image of which no centroid is known."""
    sky = SkyMapping(CAMERA, quaternion_from_pointing(*np.radians([84.0, -1.2, 0.0])))
    black, nothing = np.zeros((768, 1024), np.uint8), (np.empty((0, 2)), np.empty(0, int))
    plain, picture = (annotated(black, *nothing, each, YEAR) for each in (None, sky))
    assert not plain.any()
    # Alnilam, at RA 84.05, Dec -1.20, with its name to the right.
    column = sky.pixels(load_catalog().directions(YEAR)[load_catalog().hip == 26311])[0]
    u, v = column.round().astype(int)
    assert picture[v - 8:v + 1, u + 12:u + 50].any()


def test_stars_have_the_names_of_the_astronomical_union():
    """Each of a star of the catalogue has the brightness that people know it by."""
    catalog = load_catalog()
    magnitude = dict(zip(catalog.hip.tolist(), catalog.magnitude.tolist()))
    names = {name: hip for hip, name in STAR_NAMES.items()}
    assert len(names) == len(STAR_NAMES) > 440
    assert all(name.isascii() and name.strip() == name for name in names)
    for name, hip, V in (('Sulafat', 93194, 3.3), ('Cursa', 23875, 2.8), ('Hatysa', 26241, 2.8),
                         ('Tabit', 22449, 3.2), ('Sirius', 32349, -1.4), ('Mirfak', 15863, 1.8),
                         ('Garnet Star', 107259, 4.2), ('Albireo', 95947, 3.0),
                         ('Polaris Australis', 104382, 5.5), ('Alcor', 65477, 4.0)):
        assert names[name] == hip and magnitude[hip] == pytest.approx(V, abs=0.3), name
    # Of all stars to V 2.5 hardly any has none.
    bright = [hip for hip, V in magnitude.items() if V < 2.5]
    assert np.mean([hip in STAR_NAMES for hip in bright]) > 0.8


def test_the_belt_of_orion_is_a_line_that_spares_its_stars():
    sky = SkyMapping(CAMERA, quaternion_from_pointing(*np.radians([84.0, -1.2, 30.0])))
    picture = annotated(np.zeros((768, 1024), np.uint8), np.empty((0, 2)), np.empty(0, int), sky,
                        YEAR)
    catalog = load_catalog()
    alnitak, alnilam = (sky.pixels(catalog.directions(YEAR)[catalog.hip == hip])[0]
                        for hip in (26727, 26311))
    away = np.array([[0, -1], [1, 0]]) @ (alnilam - alnitak) / np.linalg.norm(alnilam - alnitak)

    def around(pixel):
        u, v = pixel.round().astype(int)
        return picture[v - 1:v + 2, u - 1:u + 2]
    for share in (0.4, 0.5, 0.6):
        pixel = alnitak + share * (alnilam - alnitak)
        assert around(pixel).any() and not around(pixel + 6 * away).any()
    for star in (alnitak, alnilam):
        assert not around(star).any()


def test_labels_cover_neither_circles_nor_one_another():
    uv = np.array([[500.0, 300.0], [530.0, 300.0], [470.0, 310.0], [1010.0, 20.0], [3.0, 740.0]])
    shape = (768, 1024)
    labels, columns, rows = Labels(shape, uv), *np.meshgrid(np.arange(1024), np.arange(768))
    texts = []
    for u, v in uv.astype(int):
        picture = np.zeros((*shape, 3), np.uint8)
        labels.write(picture, f'HIP {u}', (u, v), (255, 255, 255))
        texts.append(picture.any(axis=2))
    # The star in the middle has others on both sides: its name is above or below.
    assert all(text.sum() > 50 for text in texts)
    assert np.sum(texts, axis=0).max() == 1
    for u, v in uv:
        assert not np.any(texts, axis=0)[np.hypot(columns - u, rows - v) < 10].any()
    picture[:] = 0
    for _ in range(4):
        labels.write(picture, 'a name', (500, 300), (255, 255, 255))
    before = picture.copy()
    labels.write(picture, 'no place', (500, 300), (255, 255, 255))
    assert np.array_equal(picture, before)


def test_north_is_where_no_star_is():
    sky = SkyMapping(CAMERA, quaternion_from_pointing(*np.radians([180.0, -50.0, 0.0])))
    black, corner = np.zeros((768, 1024), np.uint8), np.array([[960.0, 700.0]])

    def below(spots):
        """Return whether the lower right corner has something that is not a circle."""
        picture = annotated(black, spots, np.zeros(len(spots), int), sky, YEAR)
        return (picture[650:, 900:] != annotate(black, spots)[650:, 900:]).any()
    assert below(np.empty((0, 2))) and not below(corner)
