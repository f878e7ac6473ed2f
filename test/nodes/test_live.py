# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""startracker live on a video in place of a camera: lens, attitude, page and bag of one run."""

import json
import os
import re
import signal
import subprocess
import sys
from threading import Thread
import time
from urllib.request import urlopen

import cv2
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from limits import HANGS_S
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.constellations import constellation_at, NAMES
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.exposure.image_figures import FWHM_PER_SIGMA
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, rotate
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.io.images.capture import CaptureOptions
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import mount_to_pose, quaternion_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.processes import HarnessError
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.demos.live_demo import read_stamped
from startracker_ros.tools.live import live as live_module
from startracker_ros.tools.live.live import LiveRig, run_live

CAMERA = Camera(512, 384, 1000.0, 1000.0, 255.5, 191.5, (-0.15, 0.0, 0.0, 0.0, 0.0))
# Half a minute: on a busy machine the star tracker needs much of it to build its databases.
RATE_HZ, FRAMES = 2.0, 60
MOTION = motion_from_options(MotionOptions(motion='constant_rate', rate_deg_s=(0.02, 0.05, 0.01)))


@pytest.fixture(scope='module')
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp('video') / 'sky.mkv'
    simulator = SkySimulator(
        CAMERA, MOTION, load_catalog().brighter_than(6.5), time.time() / 31557600 + 1970,
        detector_options=DetectorOptions(bit_depth=16), frame_rate_hz=RATE_HZ, seed=2)
    out = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*'FFV1'), RATE_HZ,
        (CAMERA.width, CAMERA.height),
        [cv2.VIDEOWRITER_PROP_IS_COLOR, 0, cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U])
    for index in range(FRAMES):
        out.write(simulator.frame(index / RATE_HZ).image)
    out.release()
    return path


class Browser(Thread):
    """Reads the page again and again."""

    def __init__(self):
        super().__init__(daemon=True)
        self.url, self.states, self.picture, self.page = '', [], b'', b''

    def run(self):
        while True:
            time.sleep(0.2)
            try:
                self.states.append(json.loads(urlopen(self.url + 'state.json', timeout=5).read()))
                self.picture = urlopen(self.url + 'sky.jpg', timeout=5).read()
                self.page = urlopen(self.url, timeout=5).read()
            except (OSError, ValueError):
                continue


@pytest.fixture(scope='module')
def ran(video, tmp_path_factory):
    folder, browser = tmp_path_factory.mktemp('live'), Browser()
    with pytest.MonkeyPatch.context() as patch:
        class Page(live_module.SkyPage):

            def __enter__(self):
                browser.url = self.url
                browser.start()
                return super().__enter__()
        patch.setattr(live_module, 'SkyPage', Page)
        result = run_live(folder, CaptureOptions(device=str(video)), fov_deg=30.0, record=True,
                          seconds=HANGS_S)
    return folder, result, browser


def test_the_lens_is_estimated_and_the_attitude_that_of_the_sky(ran):
    folder, result, _ = ran
    camera = load_camera(folder / 'camera.yaml')
    assert camera.fx == pytest.approx(1000.0, rel=0.005)
    assert camera.distortion[0] == pytest.approx(-0.15, abs=0.03)
    row, = result.rows
    # A busy machine may drop some.
    assert FRAMES / 2 < row['frames'] <= FRAMES and row['frames_tracking'] >= 5
    stamped = list(read_stamped(next(folder.glob('bag_*')), ('/image_raw', '/attitude')))
    images_ns = sorted(stamp_ns for record, stamp_ns, _ in stamped
                       if record.topic == '/image_raw')
    steps = np.diff(images_ns) * 1e-9 * RATE_HZ
    # A busy machine may have dropped one.
    assert steps.min() > 0.99 and np.abs(steps - np.round(steps)).max() < 0.01
    # Recording begins a little after the first image: the last one is the last of the video.
    begin_ns = images_ns[-1] - round((FRAMES - 1) / RATE_HZ * 1e9)
    errors = []
    for record, _, message in stamped:
        if record.topic == '/attitude':
            time_s = (ns_from_stamp(message.header.stamp) - begin_ns) * 1e-9
            errors.append(attitude_error(quaternion_from_message(message),
                                         MOTION.at(time_s).q_icrf_from_sensor) / ARCSEC)
    assert len(errors) >= 5
    # A pixel is 206 arcsec; the attitudes are corrected for aberration.
    assert np.abs(errors)[:, :2].max() < 100 and np.abs(errors)[:, 2].max() < 400


def test_the_page_shows_state_and_sky_while_it_runs(ran):
    folder, _, browser = ran
    states = [state.get('state', '') for state in browser.states]
    assert any(state.startswith('TRACKING') for state in states), states
    # State, attitude and tracks are messages of their own: one may be a frame ahead.
    tracking = next(state for state in browser.states if state['state'].startswith('TRACKING')
                    and state['right ascension'] != '-' and state['stars tracked'] != '0')
    _, degrees, sigma = tracking['declination'].splitlines()
    assert abs(float(degrees.removesuffix(' deg'))) < 2
    assert 0 < float(sigma.split()[1]) < 206
    boresights = [rotate(MOTION.at(index / RATE_HZ).q_icrf_from_sensor, [0.0, 0.0, 1.0])
                  for index in range(FRAMES)]
    assert tracking['constellation'] in {NAMES[constellation_at(one)] for one in boresights}
    assert int(tracking['stars tracked']) >= 4
    assert float(re.search(r'newest (.*) s ago', tracking['camera'])[1]) < 5
    # A video does not say how it was exposed.
    assert tracking['exposure'] == '-'
    focused = next(state['focus'] for state in browser.states if 'px' in state.get('focus', ''))
    assert float(focused.split()[0]) == pytest.approx(
        FWHM_PER_SIGMA * DetectorOptions().psf_sigma_px, rel=0.1)
    assert b'<img' in browser.page
    for content in (browser.picture, (folder / 'sky.jpg').read_bytes()):
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (384, 512, 3)
        # Marks are coloured.
        assert (np.ptp(picture.astype(int), axis=2) > 60).sum() > 200


def test_a_foreign_attitude_that_is_invalid_is_passed_over(tmp_path):
    header = make_header(1, 'icrf')
    with LiveRig(tmp_path, CAMERA) as rig:
        publisher = rig.probe.advertise(PoseWithCovarianceStamped, 'attitude_cov', qos.LIST)

        def send():
            publisher.publish(PoseWithCovarianceStamped(header=header))
            publisher.publish(mount_to_pose(np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3), header))
        rig.probe.send_until(send, lambda: rig.attitude is not None, 'the attitude')
        assert (rig.attitude == [0, 0, 0, 1]).all() and (rig.covariance == np.eye(3)).all()


def test_a_tracker_whose_stars_jump_has_no_sequence_of_images(tmp_path):
    jump = DiagnosticStatus(message='ACQUIRING', values=[
        KeyValue(key='reason', value='two identifications 360 deg/s apart')])
    with LiveRig(tmp_path, CAMERA) as rig:
        publisher = rig.probe.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
        assert rig.problem == ''
        rig.probe.send_until(lambda: publisher.publish(jump), lambda: rig.problem, 'the jump')
        assert rig.texts()['state'].endswith(
            'not one sequence: two identifications 360 deg/s apart; solve unrelated photographs '
            'with startracker solve')
        tracks = DiagnosticStatus(message='TRACKING')
        rig.probe.send_until(lambda: publisher.publish(tracks), lambda: not rig.problem, 'tracks')


def test_unrelated_photographs_are_named_as_such(tmp_path, sky_data):
    with pytest.raises(HarnessError, match=r'not one sequence: two in a row are [\d.]+ deg apart '
                       r'in 0\.1 s; solve unrelated photographs with startracker solve'):
        run_live(tmp_path, CaptureOptions(device=str(sky_data / 'night-sky-11deg')), fov_deg=11.4)


def test_what_gives_no_images_is_named(tmp_path):
    with pytest.raises(HarnessError, match='nothing.mkv: no such file'):
        run_live(tmp_path, CaptureOptions(device=str(tmp_path / 'nothing.mkv')))
    cv2.imwrite(str(tmp_path / 'black.png'), np.zeros((64, 64), np.uint8))
    with pytest.raises(HarnessError, match='no image is solved'):
        run_live(tmp_path, CaptureOptions(device=str(tmp_path / '*.png')), fov_deg=20.0)


@pytest.mark.parametrize('moment', ['composed_pipeline.log', 'camera_source.log'])
def test_ctrl_c_of_a_terminal_ends_it_in_order(ran, video, tmp_path, moment):
    """While its nodes are imported, and while they work: to all of its process group."""
    live = subprocess.Popen(
        [sys.executable, '-m', 'startracker_ros', 'live', '--device', str(video), '--camera',
         str(ran[0] / 'camera.yaml'), '--port', '0', '-o', str(tmp_path), '--record', '--json'],
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        end_s = time.monotonic() + HANGS_S
        while not (tmp_path / 'logs' / moment).exists():
            assert live.poll() is None and time.monotonic() < end_s
            time.sleep(0.01)
        os.killpg(live.pid, signal.SIGINT)
        stdout, stderr = live.communicate(timeout=HANGS_S)
    finally:
        live.kill()
    assert live.returncode == 0 and json.loads(stdout)['name'] == 'live', stderr
    assert 'Traceback' not in stderr and 'cleanly' not in stderr
    assert not any('Traceback' in log.read_text() for log in (tmp_path / 'logs').iterdir())
