# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs of uncalibrated cameras: lenses estimated, and images that show no stars."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from skies import frame
from startracker_evaluation.campaign.fisheyes import draw_night
from startracker_evaluation.campaign.lenses import draw_lens_field, solve_lens_fields
import startracker_ros as st
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.io.images.images import ImageError, read_image, read_photograph
from startracker_ros.io.output import OutputError
from startracker_ros.io.several_files import OneOfSeveral
from startracker_ros.photographs.detections import Detections
from startracker_ros.photographs.epoch_and_site import epoch_of, ObserverSite
from startracker_ros.photographs.estimated_lens import estimate_lens
from startracker_ros.photographs.ladder import LadderIdentifier
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.solve import (
    given_camera, output_names, Outputs, solve_files, Solvers)

WIDE = IdentificationOptions(fov_error_percent=5.0)
# Where no field fits, a search lasts until its time is over.
HASTY = replace(WIDE, time_limit_s=0.2)
SIDE_PX = 384


@pytest.fixture(scope='module')
def solver():
    return PhotographSolver(2019.57, WIDE)


def noise(rng):
    return rng.normal(60, 12, (SIDE_PX, SIDE_PX))


def wall(rng):
    """Bricks with mortar between them."""
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    mortar = (y % 24 < 3) | ((x + 24 * (y // 24 % 2)) % 48 < 3)
    return np.where(mortar, 170, 90) + rng.normal(0, 10, (SIDE_PX, SIDE_PX))


def clouds(rng):
    image = sum(cv2.resize(rng.normal(0, 1, (n, n)), (SIDE_PX, SIDE_PX),
                           interpolation=cv2.INTER_CUBIC) * 40 / n ** 0.5
                for n in (3, 6, 12, 24, 48))
    return 120 + image + rng.normal(0, 2, (SIDE_PX, SIDE_PX))


def face(rng):
    image = np.full((SIDE_PX, SIDE_PX), 40.0)
    cv2.ellipse(image, (192, 192), (110, 150), 0, 0, 360, 170, -1)
    for u in (150, 234):
        cv2.circle(image, (u, 160), 14, 245, -1)
        cv2.circle(image, (u, 160), 5, 10, -1)
    cv2.ellipse(image, (192, 260), (45, 15), 0, 0, 180, 80, 5)
    return cv2.GaussianBlur(image, (0, 0), 2) + rng.normal(0, 4, (SIDE_PX, SIDE_PX))


def city(rng):
    """Windows in rows, some of them lit."""
    image = rng.normal(15, 3, (SIDE_PX, SIDE_PX))
    for v in range(120, SIDE_PX, 14):
        for u in range(6, SIDE_PX - 6, 10):
            if rng.random() < 0.4:
                image[v:v + 4, u:u + 3] += rng.uniform(40, 220)
    return image


def many_bright_pixels(rng):
    image = rng.normal(20, 3, (SIDE_PX, SIDE_PX))
    image[rng.random(image.shape) < 0.2] += 150
    return image


def random_spots(rng):
    image = np.zeros((SIDE_PX, SIDE_PX))
    for u, v in rng.uniform(8, SIDE_PX - 8, (50, 2)).astype(int):
        image[v, u] = 10 ** rng.uniform(2.3, 4)
    return cv2.GaussianBlur(image, (0, 0), 1.2) + rng.normal(20, 2, image.shape)


@pytest.mark.parametrize('draw', [
    noise, wall, clouds, face, many_bright_pixels,
    *(pytest.param(draw, marks=pytest.mark.slow) for draw in (city, random_spots))])
@pytest.mark.parametrize('seed', [0, *(pytest.param(seed, marks=pytest.mark.long)
                                       for seed in (1, 2, 3))])
def test_images_without_stars_have_no_attitude_but_a_reason(solver, draw, seed):
    image = draw(np.random.default_rng(seed)).clip(0, 255).astype(np.uint8)
    solution = solver.solve(image, Camera.from_fov(SIDE_PX, SIDE_PX, 30.0))
    assert solution.quaternion is None
    assert solution.identification.reason
    assert solution.identification.status != 'identified'


@pytest.mark.parametrize('image, status', [
    (np.zeros((480, 640), np.uint8), 'blank'),
    (np.full((480, 640), 255, np.uint8), 'blank'),
    (np.arange(36, dtype=np.uint8).reshape(6, 6), 'too_small'),
    (np.ones((1, 1), np.uint8), 'too_small'),
])
def test_black_white_and_tiny_images_are_named(image, status):
    height, width = image.shape
    solution = PhotographSolver(2020.0, WIDE).solve(image, Camera.from_fov(width, height, 50.0))
    assert solution.identification.status == status
    assert solution.identification.reason


def test_a_thumbnail_is_not_solved(monkeypatch):
    """Its pixels resolve no stars: no database is built for it."""
    monkeypatch.setattr('startracker_ros.photographs.ladder.UncalibratedPyramid', None)
    rng = np.random.default_rng(1)
    image = rng.integers(10, 20, (64, 64), dtype=np.uint8)
    image[rng.integers(4, 60, 12), rng.integers(4, 60, 12)] = 200
    solution = PhotographSolver(2020.0, WIDE).solve(image, Camera.from_fov(64, 64, 50.0))
    assert solution.quaternion is None
    assert 'deg wide' in solution.identification.reason


@pytest.mark.slow
def test_a_field_given_with_too_coarse_pixels_is_dropped():
    """At 63 deg the pixels would be 0.31 deg wide; those of its true field are 0.29."""
    camera = Camera.from_fov(225, 225, 60.0)
    sky = st.SkySimulator(camera, 2026.5, motion='inertial', ra_deg=84.0, dec_deg=5.0,
                          faint_limit=5.0)
    image = sky.frame(0.0).image
    assert st.solve(image).solved
    solution = st.solve(image, 63.0)
    assert solution.solved and solution.fov_deg == pytest.approx(60, abs=1)
    assert solution.dropped is not None


@pytest.mark.slow
@pytest.mark.parametrize('count', [4, pytest.param(12, marks=pytest.mark.long)])
def test_lenses_of_all_shapes_are_estimated(count):
    outcome = solve_lens_fields(count, 11)
    assert not outcome.wrong.any()
    # The aim of the campaign is 98 %.
    assert np.mean(outcome.correct) >= 0.75


def test_a_draw_of_a_lens_can_be_repeated():
    one, two = (draw_lens_field(np.random.default_rng(5)) for _ in range(2))
    assert one.camera == two.camera
    np.testing.assert_array_equal(one.centroids.uv, two.centroids.uv)


@pytest.mark.parametrize('given_deg', [10.95, 11.9])
def test_a_field_of_view_told_five_percent_off(sky_data, given_deg):
    """And each image saved as JPEG: blocks and noise of compression are not stars."""
    paths = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[::3]
    rows = solve_files(paths, fov_deg=given_deg, epoch_year=2019.57, options=WIDE).rows
    for row in rows:
        assert row['solved'], (row['file'], row['reason'])
        assert row['fov_deg'] == pytest.approx(11.425, abs=0.02)
        assert len(row['quaternion']) == 4 and len(row['covariance_sensor']) == 9
        assert row['false_alarm_probability'] < 1e-5
        assert row['status'] == 'identified' and row['detected'] >= row['matched']


def test_a_compressed_image_is_solved(sky_data, tmp_path):
    image = read_image(sorted((sky_data / 'night-sky-11deg').glob('*.png'))[2])
    cv2.imwrite(str(tmp_path / 'a.jpg'), (image / 16).clip(0, 255).astype(np.uint8),
                [cv2.IMWRITE_JPEG_QUALITY, 80])
    row, = solve_files([tmp_path / 'a.jpg'], fov_deg=11.4, epoch_year=2019.57, options=WIDE).rows
    assert row['solved'], row['reason']


def test_spots_of_any_shape_are_detected():
    """Comas, which the extractor for the flight rejects, are the brightest of the spots."""
    rng = np.random.default_rng(3)
    image = rng.normal(30, 2, (300, 400))
    where = [(50, 60), (200, 150), (330, 220), (120, 240)]
    for u, v in where:
        for step in range(8):
            cv2.circle(image, (u + step, v + step // 2), 1 + step // 3, 120.0 - 8 * step, -1)
    _, spots, *_ = Detections(image.clip(0, 255).astype(np.uint8))
    nearest = np.linalg.norm(spots.uv[:4, None] - (np.array(where) + [3.5, 1.5]), axis=-1)
    assert (nearest.min(axis=0) < 3).all()


def test_the_blurred_side_of_a_wide_lens_does_not_fill_each_list():
    """All stars are saturated: the wide ones of one side seem the brightest."""
    rng = np.random.default_rng(4)
    image = rng.normal(20, 2, (600, 800))
    spot = np.stack([rng.uniform(10, 790, 400), rng.uniform(10, 590, 400)], 1).astype(int)
    for u, v in spot:
        cv2.circle(image, (u, v), 4 if u < 200 else 2, 255.0, -1)
    # No point can be fitted to saturated stars: there is no first list.
    spots, spread, _ = Detections(image.clip(0, 255).astype(np.uint8))
    blurred = [np.mean(one.uv[:, 0] < 200) for one in (spots, spread)]
    assert blurred[0] > 0.9 and blurred[1] < 0.7


def test_unreadable_images_are_named_before_they_are_decoded(tmp_path):
    huge = cv2.imencode('.png', np.zeros((4, 4), np.uint8))[1].tobytes()
    huge = huge[:16] + (25_000).to_bytes(4, 'big') + (20_000).to_bytes(4, 'big') + huge[24:]
    jpeg = cv2.imencode('.jpg', np.random.default_rng(1).integers(
        0, 255, (200, 300), dtype=np.uint8))[1].tobytes()
    for name, content, words in (
            ('huge.png', huge, '25000 x 20000 px'), ('part.jpg', jpeg[:3000], 'truncated JPEG')):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ImageError, match=words):
            read_image(tmp_path / name)
    (tmp_path / 'whole.jpg').write_bytes(jpeg)
    assert read_image(tmp_path / 'whole.jpg').shape == (200, 300)


def test_pictures_of_one_name_do_not_overwrite_each_other(tmp_path):
    image = np.zeros((40, 50), np.uint8)
    for folder in ('a', 'b'):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / 'same.png'), image)
    rows = solve_files([tmp_path / 'a' / 'same.png', tmp_path / 'b' / 'same.png'], fov_deg=20,
                       epoch_year=2020.0, outputs=Outputs(tmp_path / 'out')).rows
    assert {file.name for file in (tmp_path / 'out').iterdir()} == {'same.png', 'same-2.png'}
    assert all(row['status'] == 'blank' and 'all pixels' in row['reason'] for row in rows)


def test_a_file_that_fails_does_not_lose_the_results_of_others(sky_data, tmp_path):
    paths = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[:3]
    (tmp_path / 'bad.png').write_bytes(b'no image')
    # Where its header has to be there is something else already.
    (tmp_path / f'{paths[1].stem}.wcs').mkdir()
    result = solve_files([paths[0], tmp_path / 'bad.png', *paths[1:]], fov_deg=11.4,
                         epoch_year=2019.57, outputs=Outputs(wcs_folder=tmp_path))
    first, bad, second, third = result.rows
    assert all(row['solved'] for row in (first, second, third))
    assert bad['status'] == 'unreadable' and 'OpenCV' in bad['reason']
    assert [row['not_written'] for row in (first, bad, third)] == [''] * 3
    assert f'{paths[1].stem}.wcs' in second['not_written']
    assert (tmp_path / f'{paths[2].stem}.wcs').is_file()
    (tmp_path / 'file').touch()
    with pytest.raises(OutputError, match='file'):
        solve_files(paths, outputs=Outputs(tmp_path / 'file'))


def test_what_OneOfSeveral_files_meets_is_reported():
    reasons = []
    for error in (ValueError('no such thing'), IndexError('7')):
        with OneOfSeveral(reasons.append):
            raise error
    assert reasons[0] == 'no such thing'
    assert 'please report it: IndexError in test_photographs.py, line' in reasons[1]
    with pytest.raises(KeyboardInterrupt), OneOfSeveral(reasons.append):
        raise KeyboardInterrupt
    with pytest.raises(SystemError), OneOfSeveral(reasons.append):
        # As code in C does.
        raise SystemError('returned with an error set') from KeyboardInterrupt()
    assert len(reasons) == 2


def test_names_of_files_are_unique():
    paths = [Path(name) for name in ('b/a.png', 'c/a.png', 'c/a-2.png', 'c/a.jpg')]
    assert output_names(paths) == ['a', 'a-2', 'a-2-2', 'a-3']


@pytest.fixture(scope='module')
def any_field():
    return PhotographSolver(2019.57, IdentificationOptions(time_limit_s=HASTY.time_limit_s))


def test_an_image_without_a_told_field_is_solved(any_field, sky_data):
    paths = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[2:8:2]
    for path in paths:
        solution = any_field.solve(read_image(path))
        assert solution.quaternion is not None, solution.identification.reason
        assert np.degrees(solution.camera.seen_x_rad) == pytest.approx(11.425, abs=0.02)
        assert solution.identification.false_alarm_probability < 1e-5


@pytest.mark.slow
def test_a_field_that_does_not_fit_is_dropped(any_field, sky_data):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[4]
    nominal = Camera.from_fov(1024, 768, 9.0)
    solution = any_field.solve(read_image(path), nominal)
    assert np.degrees(solution.camera.seen_x_rad) == pytest.approx(11.425, abs=0.02)
    assert solution.dropped == nominal


@pytest.mark.slow
def test_a_dropped_field_is_named_and_one_that_fits_is_not_dropped(any_field, sky_data):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[4]
    result = solve_files([path], fov_deg=14.0, options=HASTY)
    row, = result.rows
    assert row['solved'] and row['fov_deg'] == pytest.approx(11.425, abs=0.02)
    assert result.conditions['fov_deg'] == f'{path.name}: 14 deg given, 11.4 fits'
    assert any_field.solve(read_image(path), Camera.from_fov(1024, 768, 11.4)).dropped is None


def test_a_header_with_a_field_too_small_for_the_catalogue_is_not_an_error(sky_data):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[4]
    photograph, when = read_photograph(path)._replace(fov_deg=0.2), epoch_of(2019.57)
    solution, _ = Solvers(None, None, WIDE).solve(
        path, photograph, when, ObserverSite().observer(when), Bodies())
    assert np.degrees(solution.camera.seen_x_rad) == pytest.approx(11.425, abs=0.02)


@pytest.mark.slow
def test_a_field_that_is_given_is_never_worse_than_none(any_field, sky_data):
    """Twelve false stars are brighter than all others: a short search does not reach these."""
    stars = CentroidExtractor().measure(read_image(
        sorted((sky_data / 'night-sky-11deg').glob('*.png'))[2])).centroids
    rng = np.random.default_rng(3)
    uv = np.concatenate([rng.uniform([20, 20], [1000, 740], (12, 2)), stars.uv])
    seen = frame(uv, np.concatenate([np.linspace(9, 8, 12) * stars.flux.max(), stars.flux]))
    assert any_field.solve_lists([seen], (768, 1024)).solved
    for given_deg in (4.0, 30.0, 80.0):
        solution = any_field.solve_lists([seen], (768, 1024),
                                         Camera.from_fov(1024, 768, given_deg))
        assert solution.solved and solution.fov_deg == pytest.approx(11.42, abs=0.02), given_deg


@pytest.mark.slow
def test_a_fisheye_with_a_given_field_is_a_fisheye(any_field):
    night = draw_night(np.random.default_rng(6), 'equisolid')
    height, width = night.shape
    for given_deg in (12.0, 100.0):
        solution = any_field.solve_lists([night.centroids], night.shape,
                                         Camera.from_fov(width, height, given_deg))
        assert solution.camera.model.equidistant
        assert night.error_px(solution.sky) < 2
    # No rectilinear lens has such a field, and no one has the others.
    assert given_camera(width, height, 174.0) is None
    for wrong_deg in (0.0, 0.1, 400.0):
        with pytest.raises(CameraError, match=f'field of view {wrong_deg:g}'):
            given_camera(width, height, wrong_deg)


@pytest.mark.long
@pytest.mark.parametrize('draw', [city, random_spots])
def test_no_field_of_view_explains_what_is_not_sky(any_field, draw):
    image = draw(np.random.default_rng(0)).clip(0, 255).astype(np.uint8)
    solution = any_field.solve(image)
    assert solution.quaternion is None
    reason = solution.identification.reason
    assert '0.6 to 120 deg' in reason and 'fisheyes' in reason
    # And none that is given.
    height, width = image.shape
    given = any_field.solve(image, Camera.from_fov(width, height, 12.0))
    assert given.quaternion is None and 'about 12 deg, 0.6 to 120 deg' in given.reason


def test_a_lens_that_folds_its_image_at_the_found_focal_length_is_rejected(sky_data):
    path = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[3]
    nominal = Camera.from_fov(1024, 768, 11.4)
    attempt = next(attempt for attempt in LadderIdentifier(nominal, 2019.57, WIDE).identify(
        list(Detections(read_image(path)))) if attempt.identification.attitude is not None)
    wide = Camera(1024, 768, 1500, 1500, 511.5, 383.5, (-0.35, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(CameraError, match='folds'):
        wide.with_focal_ratio(0.5)
    lens = estimate_lens(attempt._replace(
        camera=wide,
        identification=replace(attempt.identification, focal_ratio=0.5)), 0.05)
    assert 'folds' in lens.rejected
