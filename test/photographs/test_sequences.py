# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of one camera: what one of them has shown identifies the next."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import startracker_ros as st
from startracker_ros.core.astro.earth import gcrs_from_itrf
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, matrix_from_quaternion, multiply, quaternion_from_matrix,
    quaternion_from_pointing, random_attitude, rotate, turned)
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.io.images.images import Photograph, read_image
from startracker_ros.photographs.blind import BlindIdentifier
from startracker_ros.photographs.detections import Detections
from startracker_ros.photographs.epoch_and_site import Epoch
from startracker_ros.photographs.ladder import LadderIdentifier
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.same_camera import Known, SameCamera
from startracker_ros.photographs.sequence import ImageSequence
from startracker_ros.photographs.solution import Solution
from startracker_ros.photographs.solve import solve_files, Solvers
from startracker_ros.photographs.unknown_lens import UnknownLensIdentifier

YEAR = 2020.0
NARROW = Camera.from_fov(1392, 1040, 6.1)
WIDE = Camera(800, 600, 858.0, 858.0, 410.0, 290.0, (-0.05, 0.0, 0.0, 0.0, 0.0))
FISHEYE = Camera(1280, 960, 300.0, 300.0, 650.0, 485.0, (-0.02, 0.003, 0.0, 0.0), 'equidistant')
EARTH_RAD_S = 7.292115e-5
OPTIONS = IdentificationOptions(false_alarm_max=1e-5)


def identifier(options=OPTIONS):
    blind = BlindIdentifier(YEAR, options)
    return SameCamera(blind, UnknownLensIdentifier(YEAR, blind.wide_quads), options)


@pytest.fixture(scope='module')
def same():
    return identifier()


def spots(uv, flux):
    order = np.argsort(-flux)
    return Centroids(uv[order], flux[order], np.full(len(uv), 20.0), np.full(len(uv), 0.1))


def few_stars(rng, camera, quaternion, count, false):
    """Return a list with the count brightest stars of an attitude among false spots."""
    catalog = load_catalog().brighter_than(9.0)
    sensor = catalog.directions(YEAR) @ matrix_from_quaternion(quaternion)
    seen = sensor[:, 2] > np.cos(camera.corner_angle_rad)
    uv, magnitude = camera.project(sensor[seen]), catalog.magnitude[seen]
    inside = camera.contains(uv)
    uv, magnitude = uv[inside], magnitude[inside]
    brightest = np.argsort(magnitude)[:count]
    others = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (false, 2))
    faintest = 10 ** (-0.4 * magnitude[brightest].max())
    return spots(np.concatenate([uv[brightest] + rng.normal(0, 0.1, (count, 2)), others]),
                 np.concatenate([10 ** (-0.4 * magnitude[brightest]),
                                 faintest * rng.uniform(0.5, 3.0, false)]))


def first(same, centroids, camera, expected):
    known = Known(camera, np.array(expected), 'before')
    return next(same.identify([centroids], known), None)


def test_few_stars_are_identified_by_the_attitude_that_is_expected(same):
    """Alone, seven stars among 24 false spots of a field of 6 deg are mostly too few."""
    rng, helped, alone = np.random.default_rng(3), 0, 0
    for _ in range(20):
        truth = random_attitude(rng)
        centroids = few_stars(rng, NARROW, truth, 7, 24)
        near = turned(truth, rng.normal(0, np.radians(0.1), 3))
        elsewhere = random_attitude(rng)
        found = first(same, centroids, NARROW, [elsewhere, near])
        other = first(same, centroids, NARROW, [elsewhere])
        for attempt in filter(None, (found, other)):
            error = attitude_error(attempt.identification.attitude.quaternion, truth)
            assert np.linalg.norm(error) < np.radians(0.2)
        helped, alone = helped + (found is not None), alone + (other is not None)
    assert helped == 20
    assert alone <= 10


@pytest.mark.parametrize('camera', [NARROW, WIDE, FISHEYE], ids=['narrow', 'wide', 'fisheye'])
def test_lists_without_a_sky_are_not_accepted_by_a_known_lens(camera):
    """Of 100 lists with a probability of chance below 1 % at most a few would be right."""
    options = replace(OPTIONS)
    # Above the range of the option, so that all candidates are seen.
    object.__setattr__(options, 'false_alarm_max', 30.0)
    rng, same, best = np.random.default_rng(4), identifier(options), []
    for _ in range(100):
        count = int(rng.choice([8, 15, 30, 60]))
        uv = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (count, 2))
        known = Known(camera, np.array([random_attitude(rng) for _ in range(3)]), 'before')
        found = same.identify([spots(uv, rng.pareto(1.0, count) + 1)], known)
        best.append(min((one.identification.false_alarm_probability for one in found),
                        default=1.0))
    assert min(best) > 1e-4
    assert np.count_nonzero(np.array(best) < 0.01) <= 3


def test_four_stars_are_identified_by_a_known_focal_length():
    """They are the brightest of 24 spots, but for one."""
    rng, found = np.random.default_rng(5), 0
    ladder = LadderIdentifier(Camera.from_fov(NARROW.width, NARROW.height, 6.0), YEAR, replace(
        OPTIONS, fov_error_percent=5.0))
    for _ in range(12):
        truth = random_attitude(rng)
        stars = few_stars(rng, NARROW, truth, 4, 0)
        false = rng.uniform([0, 0], [NARROW.width - 1, NARROW.height - 1], (20, 2))
        flux = np.append(2 * stars.flux.max(), stars.flux.min() * rng.uniform(0.2, 0.8, 19))
        centroids = spots(np.concatenate([stars.uv, false]), np.concatenate([stars.flux, flux]))
        attempt = next(ladder.identify_few([centroids], NARROW, 0.002, 0.125))
        attitude = attempt.identification.attitude
        if attitude is not None:
            assert np.linalg.norm(attitude_error(attitude.quaternion, truth)) < np.radians(0.1)
            found += 1
    assert found >= 8


def test_spots_that_do_not_move_with_the_stars_are_left_out():
    photograph, hot = Photograph(np.zeros((1040, 1392), np.uint8)), [(300, 45), (900, 700)]
    solver, moving, tracked = PhotographSolver(YEAR, OPTIONS), ImageSequence(), ImageSequence()
    when = Epoch(YEAR, 'today', False)
    for ra_deg in (30.0, 80.0, 150.0):
        frame = st.SkySimulator(NARROW, YEAR, motion='constant_rate', ra_deg=ra_deg, dec_deg=40.0,
                                rate_deg_s=(0.0, 0.0, 0.0)).frame(0.0)
        image = frame.image.copy()
        for u, v in hot:
            # As wide as a star.
            image[v - 1:v + 2, u - 1:u + 2] += np.array(
                [[5, 20, 5], [20, 80, 20], [5, 20, 5]], image.dtype) * 8
        solution = replace(solver.solve(image, NARROW),
                           photograph=photograph._replace(image=image))
        moving.add(f'{ra_deg}', photograph, when, solution)
        for number in range(2 if ra_deg == 30.0 else 0):
            tracked.add(f'{number}', photograph, when, solution)
    fixed = moving.known(photograph, when).fixed
    apart = np.linalg.norm(fixed[:, None] - hot, axis=2)
    assert (apart.min(axis=1) < 1).all() and (apart.min(axis=0) < 1).all()
    # Of one attitude, as a mount keeps it, any spot may be a star.
    assert not len(tracked.known(photograph, when).fixed)
    near = [np.linalg.norm(each.uv[:, None] - hot, axis=2).min()
            for each in (*Detections(image, fixed), Detections(image, fixed).peaks)]
    assert min(near) > 1.5
    assert np.linalg.norm(Detections(image).peaks.uv[:, None] - hot, axis=2).min() < 1


def test_images_of_one_camera_are_solved_by_the_lens_of_the_one_before(sky_data):
    folder = sky_data / 'night-sky-11deg'
    paths = sorted(folder.glob('*.png'))
    rows = solve_files(paths, epoch_year=2019.57).rows
    assert all(row['solved'] for row in rows)
    assert rows[0]['lens_from'] == ''
    assert sum(row['lens_from'] != '' for row in rows) >= len(rows) - 2
    for path, row in zip(paths, rows):
        alone = st.solve(path, epoch=2019.57)
        apart = attitude_error(np.array(row['quaternion']), alone.quaternion) / ARCSEC
        sigma = np.sqrt(np.diag(alone.covariance_sensor)) / ARCSEC
        assert np.hypot(*(alone.ra_deg - row['ra_deg'], alone.dec_deg - row['dec_deg'])) < 0.003
        assert (np.abs(apart) < 5 * sigma + 1).all()


def test_images_before_the_first_solved_one_are_tried_again(sky_data, tmp_path):
    """The noise leaves too few stars to be found anywhere in the sky."""
    image = read_image(sorted((sky_data / 'night-sky-11deg').glob('*.png'))[1])
    noise = np.random.default_rng(1).normal(0, 1900.0, image.shape)
    cv2.imwrite(str(tmp_path / 'a.png'), np.clip(image + noise, 0, 65535).astype(np.uint16))
    cv2.imwrite(str(tmp_path / 'b.png'), image)
    noisy, clear = solve_files([tmp_path / 'a.png', tmp_path / 'b.png'], epoch_year=2019.57).rows
    assert noisy['solved'] and noisy['lens_from'] == 'b.png' and clear['lens_from'] == ''
    assert np.hypot(noisy['ra_deg'] - clear['ra_deg'], noisy['dec_deg'] - clear['dec_deg']) < 0.05
    alone, = solve_files([tmp_path / 'a.png'], epoch_year=2019.57).rows
    assert not alone['solved']


def test_images_of_a_calibrated_camera_are_solved_once(sky_data, tmp_path, monkeypatch):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[1]
    image = read_image(path)
    cv2.imwrite(str(tmp_path / 'a.png'), np.full_like(image, 1000))
    cv2.imwrite(str(tmp_path / 'b.png'), image)
    save_camera(st.solve(path, epoch=2019.57).camera, tmp_path / 'camera.yaml')
    solved, solve = [], Solvers.solve
    monkeypatch.setattr(Solvers, 'solve', lambda self, path, *arguments: (
        solved.append(path.name) or solve(self, path, *arguments)))
    rows = solve_files([tmp_path / 'a.png', tmp_path / 'b.png'], epoch_year=2019.57,
                       camera_file=tmp_path / 'camera.yaml').rows
    assert [row['solved'] for row in rows] == [False, True] and rows[1]['lens_from'] == ''
    assert solved == ['a.png', 'b.png']


def test_an_image_of_another_camera_is_solved_as_if_it_were_alone(sky_data, tmp_path):
    """It is as large as the one before, so that it might be of the same camera."""
    path, other = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[:2]
    image = read_image(other)
    height, width = image.shape
    middle = image[height // 4:height - height // 4, width // 4:width - width // 4]
    cv2.imwrite(str(tmp_path / 'a.png'), read_image(path))
    cv2.imwrite(str(tmp_path / 'b.png'), cv2.resize(middle, (width, height)))
    rows = solve_files([tmp_path / 'a.png', tmp_path / 'b.png'], epoch_year=2019.57).rows
    alone, = solve_files([tmp_path / 'b.png'], epoch_year=2019.57).rows
    assert rows[0]['solved'] and rows[1]['solved'] and rows[1]['lens_from'] == ''
    assert rows[1]['quaternion'] == alone['quaternion']
    assert rows[1]['fov_deg'] == pytest.approx(rows[0]['fov_deg'] / 2, rel=0.02)


def test_a_night_of_a_fisheye_that_stands_on_the_earth(tmp_path):
    """The images have no times: the turn between two of them predicts the next."""
    start = quaternion_from_pointing(*np.radians([84.0, 35.0, 20.0]))
    rate = np.degrees(rotate(conjugate(start), [0.0, 0.0, EARTH_RAD_S])).tolist()
    sky = st.SkySimulator(FISHEYE, YEAR, motion='constant_rate', ra_deg=84.0, dec_deg=35.0,
                          roll_deg=20.0, rate_deg_s=tuple(rate), faint_limit=6.0)
    v, u = np.mgrid[:FISHEYE.height, :FISHEYE.width]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    horizon = ~(FISHEYE.unproject(pixels)[:, 2].reshape(u.shape) > 0)
    truth = []
    for number in range(6):
        frame = sky.frame(600.0 * number)
        frame.image[horizon] = 0
        cv2.imwrite(str(tmp_path / f'{number}.png'), frame.image)
        truth.append(frame.q_mean)
    rows = solve_files(sorted(tmp_path.glob('*.png')), epoch_year=YEAR).rows
    assert all(row['solved'] for row in rows)
    assert [row['lens_from'] for row in rows[1:]] == [f'{number}.png' for number in range(5)]
    for row, quaternion in zip(rows, truth):
        # Of the fitted optical axis, which is a few pixels off.
        assert np.linalg.norm(attitude_error(np.array(row['quaternion']), quaternion)) < (
            np.radians(1.0))


def test_the_turn_of_the_earth_and_the_last_turn_are_expected():
    photograph = Photograph(np.zeros((600, 800), np.uint8))
    sequence, rng = ImageSequence(), np.random.default_rng(1)
    assert sequence.known(photograph, Epoch(YEAR, 'EXIF', True)) is None
    one, two = random_attitude(rng), random_attitude(rng)
    hour = 1 / 24 / 365.25
    for number, quaternion in enumerate((one, two)):
        sequence.add(f'{number}', photograph, Epoch(YEAR + number * hour, 'EXIF', True),
                     solution_of(quaternion, photograph))
    known = sequence.known(photograph, Epoch(YEAR + 3 * hour, 'EXIF', True))
    before, after = (quaternion_from_matrix(gcrs_from_itrf(YEAR + hours * hour))
                     for hours in (1, 3))
    turn = multiply(two, conjugate(one))
    for expected, found in zip(
            (two, multiply(multiply(after, conjugate(before)), two), multiply(turn, two)),
            known.expected, strict=True):
        assert np.linalg.norm(attitude_error(found, expected)) < 1e-9
    assert known.source == '1'
    # A time that is stated for all images is not that of each.
    assert len(sequence.known(photograph, Epoch(YEAR, 'option', True)).expected) == 2
    # Another size is another camera.
    assert sequence.known(Photograph(np.zeros((600, 801), np.uint8)),
                          Epoch(YEAR, 'EXIF', True)) is None


def test_other_lenses_are_searched_less_often_once_a_camera_is_certain():
    photograph, sequence = Photograph(np.zeros((600, 800), np.uint8)), ImageSequence()
    when, rng = Epoch(YEAR, 'today', False), np.random.default_rng(1)
    solved = solution_of(random_attitude(rng), photograph)
    none = Solution.none(WIDE, Centroids.empty(), 'no_candidate', '')
    sequence.add('first', photograph, when, solved)
    for number in range(10):
        assert not sequence.known(photograph, when).certain
        sequence.add(f'{number}', photograph, when, none)
    for number in range(10):
        sequence.add(f'{number}', photograph, when, replace(solved, lens_from='first'))
    searched = []
    for number in range(11, 70):
        searched += [number] * (not sequence.known(photograph, when).certain)
        sequence.add('dark', photograph, when, none)
    assert searched == [16, 32, 64]
    # Another camera: its images are searched until they are alike.
    sequence.add('other', photograph, when, solved)
    assert not any(sequence.known(photograph, when).certain for _ in range(3))


def test_an_image_that_a_certain_camera_does_not_explain_is_left_with_the_reason():
    known = Known(WIDE, np.array([[0.0, 0.0, 0.0, 1.0]]), 'before.png', certain=True)
    noise = np.random.default_rng(1).normal(100.0, 5.0, (600, 800)).astype(np.uint8)
    solution = PhotographSolver(YEAR, OPTIONS).solve(noise, known=known)
    assert not solution.solved
    assert 'not the stars of before.png and its lens' in solution.reason


def solution_of(quaternion, photograph):
    attitude = AttitudeEstimate(quaternion, np.eye(3) * 1e-12, 4, np.zeros(4), 1.0)
    found = Identification('identified', '', np.arange(1, 5), np.ones(4), np.zeros(4), attitude,
                           1.0, 1e-9)
    return Solution(spots(np.ones((4, 2)), np.ones(4)), found, WIDE, photograph=photograph,
                    sky=SkyMapping(WIDE, quaternion))


def test_mirrored_images_are_solved_and_said(sky_data, tmp_path):
    paths = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[:2]
    for path in paths:
        cv2.imwrite(str(tmp_path / path.name), read_image(path)[:, ::-1])
    flipped = [tmp_path / path.name for path in paths]
    result = solve_files(flipped, epoch_year=2019.57)
    straight = solve_files(paths, epoch_year=2019.57)
    for one, other in zip(result.rows, straight.rows):
        assert one['solved'] and one['mirrored'] and not other['mirrored']
        np.testing.assert_allclose(one['quaternion'], other['quaternion'], atol=1e-9)
    # The second one is flipped at once.
    assert result.rows[1]['lens_from'] == paths[0].name
    assert result.conditions['mirrored'] == f'{paths[0].name}; {paths[1].name}'
    assert 'mirrored' not in straight.conditions
    many = solve_files(flipped[:1] * 6, epoch_year=2019.57)
    assert many.conditions['mirrored'] == '; '.join([paths[0].name] * 4 + ['2 more'])
    solution = st.solve(flipped[0], epoch=2019.57)
    assert solution.mirrored and solution.photograph.mirrored
    assert not st.solve(paths[0], epoch=2019.57).mirrored


def test_the_lens_of_a_noisy_camera_finds_more_of_its_images(sky_data):
    paths = sorted((sky_data / 'night-sky-6deg').glob('*.png'))
    together = solve_files(paths, epoch_year=2018.35).rows
    alone = [solve_files([path], epoch_year=2018.35).rows[0] for path in paths]
    assert all(one['solved'] for one, other in zip(together, alone) if other['solved'])
    assert sum(row['solved'] for row in together) > sum(row['solved'] for row in alone)
    for one in together:
        assert not one['solved'] or one['fov_deg'] == pytest.approx(6.0745, abs=0.01)


def test_a_narrow_field_that_is_given_is_found_by_its_quads():
    """The pairs of so deep a catalogue are not built."""
    camera = Camera.from_fov(1000, 750, 1.3)
    sky = st.SkySimulator(camera, YEAR, motion='constant_rate', ra_deg=305.0, dec_deg=40.0,
                          rate_deg_s=(0.0, 0.0, 0.0))
    frame, solver = sky.frame(0.0), PhotographSolver(YEAR, replace(OPTIONS, fov_error_percent=5.0))
    nominal = Camera.from_fov(1000, 750, 1.35)
    solution = solver.solve(frame.image, nominal)
    assert np.linalg.norm(attitude_error(solution.quaternion, frame.q_mean)) < 60 * ARCSEC
    assert solution.dropped is None and solution.lens_from == ''
    assert '_database' not in vars(solver._ladder(nominal))
