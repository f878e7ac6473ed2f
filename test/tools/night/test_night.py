# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of a rendered night are found within their confidence, and none where there is none."""

from dataclasses import replace
from functools import cache
import json
from pathlib import Path

from commands import invoke
import cv2
from night_sky import AIRLESS, arcsec_per_hour, CAMERA, images, OnEarth, YEAR
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.maths.rotation import ARCSEC, random_attitude
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.tools.night.night import all_rows, measure, MET, MISSED, NOT_OBSERVABLE
from startracker_ros.tools.night.patterns import without_turns
from startracker_ros.tools.night.sources import NightError

SHAKE_ARCSEC = 20.0
DRIFT_ARCSEC_H = np.array([0.0, -600.0, 300.0])
BENT = replace(CAMERA, distortion=(0.06, 0.0, 0.0, 0.0, 0.0))
MOUNT = OnEarth(arcsec_per_hour(0, 360 * 3600.0, 0))
LATE_S = 0.05
SHEET = Path(__file__).parents[3] / 'docs' / 'results' / 'datasheet.json'


@cache
def clean():
    return measure(images(), CAMERA, AIRLESS, tracking=False)


@cache
def faulty():
    motion = OnEarth(arcsec_per_hour(*DRIFT_ARCSEC_H), SHAKE_ARCSEC * ARCSEC)
    return measure(images(motion, lens=BENT), CAMERA, AIRLESS, tracking=False)


def mounted(late_s, detector=DetectorOptions()):
    """Return the night of a moving mount whose images are stamped late_s (F,) after they are."""
    return measure(images(MOUNT, step_s=2.0, late_s=late_s, detector=detector), CAMERA, AIRLESS,
                   tracking=True)


def rows_of(night):
    return {each.case: each for each in all_rows(night)}


def contains(row, truth):
    return row.low <= truth <= row.high


@pytest.mark.slow
def test_a_clean_night_misses_no_goal():
    rows = rows_of(clean())
    assert [case for case, row in rows.items() if row.verdict == MISSED] == []
    assert sum(row.verdict == MET for row in rows.values()) >= 12
    assert rows['frames identified by themselves'].ours == 100
    assert rows['frames with a published attitude'].ours > 95


def test_the_sky_turns_too_slowly_for_the_stamps():
    rows = rows_of(clean())
    for case in ('delay, constant part', 'jitter', 'time of a line, rolling shutter'):
        assert rows[case].verdict == NOT_OBSERVABLE and rows[case].ours is None
    # What may be hidden: errors of an arcsecond at 15 arcsec/s.
    assert 10 < rows['jitter'].high < 500


@pytest.mark.slow
def test_noise_and_drift_of_the_mount_are_found():
    rows = rows_of(faulty())
    for axis in ('cross boresight', 'about boresight'):
        without = rows_of(clean())[f'temporal noise, {axis}']
        truth = np.hypot(SHAKE_ARCSEC, without.ours)
        assert contains(rows[f'temporal noise, {axis}'], truth) and without.high < truth
    for axis, truth in zip('xyz', DRIFT_ARCSEC_H):
        row = rows[f'drift about {axis}']
        assert contains(row, truth) and row.verdict == (MISSED if truth else MET)
    # The shake is in no covariance.
    assert rows['normalised error squared of an axis'].low > 1


def test_a_lens_that_is_not_in_the_camera_file_is_found():
    rows, night = rows_of(faulty()), faulty()
    uv = night.seen.uv
    shift = BENT.project(CAMERA.unproject(uv)) - uv
    left = without_turns(night.seen, shift[..., None])
    truth = np.sqrt(np.mean(left ** 2)) * CAMERA.pixel_rad / ARCSEC
    row = rows['field-of-view spatial error, of a star']
    assert row.low > 0.9 * truth
    assert contains(row, truth) and row.verdict == MISSED
    assert rows['pixel spatial error, of a star'].verdict == MET


@pytest.mark.slow
def test_late_stamps_of_a_moving_mount_are_found():
    late = np.random.default_rng(3).normal(0, 1, 60)
    rows = rows_of(mounted(tuple(LATE_S * (late - late.mean()) / late.std())))
    assert contains(rows['jitter'], 1e3 * LATE_S) and rows['jitter'].verdict == MISSED
    assert contains(rows['rate on the Earth'], 360)


@pytest.mark.long
def test_a_constant_delay_shows_in_no_row_and_the_sheet_says_so():
    delayed, prompt = (rows_of(mounted((late_s,) * 60)) for late_s in (LATE_S, 0.0))
    assert delayed['delay, constant part'].verdict == NOT_OBSERVABLE
    assert prompt['jitter'].verdict == MET and prompt['jitter'].high < 0.1e3 * LATE_S
    for case, row in prompt.items():
        other = delayed[case]
        assert row.verdict == other.verdict, case
        ends = np.array([(each.low, each.high) for each in (row, other)], float)
        np.testing.assert_allclose(*ends, rtol=0.02, atol=0.02, err_msg=case)


@pytest.mark.slow
def test_the_lines_of_a_rolling_shutter_are_found_behind_a_moving_mount():
    rows = rows_of(mounted(None, DetectorOptions(line_time_us=200.0)))
    line = rows['time of a line, rolling shutter']
    assert contains(line, 200) and line.verdict == MISSED


@pytest.mark.slow
def test_air_that_is_not_there_is_noticed():
    low = OnEarth(east_rad=1.4)
    rows = rows_of(measure(
        images(low), CAMERA, Site(48.0, 11.0, 500.0), tracking=False))
    row = rows['that of the stars over that of the air']
    assert contains(row, 0.0) and row.verdict == MISSED


def test_half_of_the_stars_of_the_limiting_magnitude_are_found():
    rows, stars = rows_of(clean()), clean().stars
    row = rows['limiting magnitude, half are found']
    near = np.abs(stars.magnitude - row.ours) < 0.1
    assert 0.3 < stars.seen[near].mean() < 0.7
    assert stars.seen[stars.magnitude < row.ours - 1].all()
    assert rows['found, V 8.5 to 9'].ours < 1


def test_the_width_of_the_star_images_is_found():
    for case, row in rows_of(clean()).items():
        if case.startswith('PSF sigma'):
            # Faint neighbours widen an image a little.
            assert row.ours == pytest.approx(DetectorOptions().psf_sigma_px, rel=0.02)
            assert row.high - row.low < 0.02


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder of images and the file of their camera."""
    folder = tmp_path_factory.mktemp('night')
    for number, (_, image) in enumerate(images(frames=24)):
        cv2.imwrite(str(folder / f'{number:03d}.png'), image)
    save_camera(CAMERA, folder / 'camera.yaml')
    return folder


def command(*words):
    done = invoke('night', *map(str, words), '--json')
    return done, json.loads(done.stdout) if done.stdout else {}


class Anywhere:
    """Looks at another field in each frame."""

    def at(self, time_s):
        rng = np.random.default_rng(round(time_s))
        return replace(OnEarth().at(time_s), q_icrf_from_sensor=random_attitude(rng))


@pytest.mark.parametrize('frames, text', ((10, 'at least 20'), (24, 'that stands still')))
def test_images_that_are_not_a_night_are_refused(frames, text):
    with pytest.raises(NightError, match=text):
        measure(images(Anywhere(), frames=frames), CAMERA, AIRLESS, tracking=False)


def test_a_mount_that_turns_is_not_a_tripod():
    with pytest.raises(NightError, match='360 arcsec/s on the Earth: --tracking'):
        measure(images(MOUNT, frames=24, step_s=2.0), CAMERA, AIRLESS, tracking=False)


@pytest.mark.slow
def test_a_frame_of_another_field_is_left_out():
    other = images(OnEarth(east_rad=1.0), frames=24)
    mixed = [wrong if number == 7 else right
             for number, (right, wrong) in enumerate(zip(images(frames=24), other))]
    rows = rows_of(measure(mixed, CAMERA, AIRLESS, tracking=False))
    assert rows['frames identified by themselves'].ours == pytest.approx(100 * 23 / 24)
    assert rows['temporal noise, cross boresight'].high < 3


@pytest.mark.slow
def test_the_command_takes_a_folder_a_site_and_a_simulated_sheet(folder):
    done, document = command(
        folder, '--camera', folder / 'camera.yaml', '--epoch', YEAR, '--interval-s', 6,
        '--site', 48, 11, 500, '--pressure-hpa', 0, '--datasheet', SHEET)
    assert done.exit_code == 0, done.stderr
    assert document['conditions']['frames'] == 24
    rows = {row['case']: row for row in document['rows']}
    sky = rows['rate of the sky']
    assert sky['low'] < 15.041 < sky['high'] and sky['verdict'] == MET
    assert rows['delay, constant part']['ours'] is None
    simulated = {row['case']: row['ours'] for row in json.loads(SHEET.read_text())['rows']}
    for kind in ('temporal noise', 'field-of-view spatial error', 'pixel spatial error'):
        for axis in ('cross boresight', 'about boresight'):
            assert rows[f'{kind}, {axis}']['simulated'] == simulated[f'{kind}, 0 deg/s, {axis}']


def test_the_command_says_what_is_missing(folder, tmp_path):
    camera = '--camera', folder / 'camera.yaml'
    for words, text, status in (
            ((folder,), 'images need --camera', 2),
            ((folder, *camera), '--epoch of the first image is needed', 1),
            ((folder, *camera, '--epoch', YEAR), '--interval-s is needed', 1),
            ((folder, *camera, '--datasheet', camera[1]), 'not a document of', 1),
            ((tmp_path, *camera, '--epoch', YEAR, '--interval-s', 6), '0 images', 1)):
        done, _ = command(*words)
        assert done.exit_code == status and text in done.stderr, done.stderr


@pytest.mark.slow
def test_the_command_takes_a_bag(folder, tmp_path):
    """Of a Bayer camera: camera_info is that of the sensor, whose cells have four equal pixels."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    image_type, info_type = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'
    k = np.array([2 * CAMERA.fx, 0, 2 * CAMERA.cx + 0.5, 0, 2 * CAMERA.fy, 2 * CAMERA.cy + 0.5,
                  0, 0, 1])
    height, width = 2 * CAMERA.height, 2 * CAMERA.width
    roi = kinds['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
    bag = tmp_path / 'bag'
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {kind: writer.add_connection(f'/tracker_1/{name}', kind, typestore=store)
                  for name, kind in (('image_raw', image_type), ('camera_info', info_type))}
        for stamp_ns, pixels in images(frames=24):
            header = kinds['std_msgs/msg/Header'](kinds['builtin_interfaces/msg/Time'](
                *divmod(stamp_ns, 10 ** 9)), 'star_tracker_optical_frame')
            for message in (
                    kinds[info_type](header, height, width, 'plumb_bob', np.zeros(5), k,
                                     np.eye(3).ravel(), np.zeros(12), 0, 0, roi),
                    kinds[image_type](header, height, width, 'bayer_rggb16', 0, 2 * width,
                                      pixels.repeat(2, 0).repeat(2, 1).view(np.uint8).ravel())):
                kind = message.__msgtype__
                writer.write(topics[kind], stamp_ns, store.serialize_cdr(message, kind))
    done, document = command(bag)
    assert done.exit_code == 0, done.stderr
    assert document['conditions']['begin'].startswith('2026-07-02T')
    _, by_folder = command(folder, '--camera', folder / 'camera.yaml', '--interval-s', 6,
                           '--epoch', document['conditions']['begin'])
    assert [row['verdict'] for row in document['rows']] == [
        row['verdict'] for row in by_folder['rows']]
    done, _ = command(bag, '--namespace', 'tracker_2')
    assert done.exit_code == 1
