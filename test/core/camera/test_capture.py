# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras by a stand-in for OpenCV, and files in their place: settings, stamps, losses."""

import time

import cv2
from limits import HANGS_S
import numpy as np
import pytest
from startracker_ros.core.exposure.control import Setting
from startracker_ros.io.images.capture import (
    Captured, CaptureError, CaptureOptions, CaptureThread, CAPTURING, ENDED, FAILED, LOST,
    open_device, V4l2Camera)

P = cv2


class FakeCapture:
    """A camera of 640 x 480 px and 20 Hz; fixed are settings that it ignores."""

    def __init__(self, fixed=None, stamp_age_s=None, pixels=None, opened=True):
        self.values = {P.CAP_PROP_FRAME_WIDTH: 640.0, P.CAP_PROP_FRAME_HEIGHT: 480.0,
                       P.CAP_PROP_FPS: 20.0, P.CAP_PROP_GAIN: 5.0, P.CAP_PROP_EXPOSURE: 156.0,
                       P.CAP_PROP_AUTO_EXPOSURE: 3.0, P.CAP_PROP_CONVERT_RGB: 1.0,
                       P.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*'YUYV'))}
        self.fixed = fixed or {}
        self.order = []
        self.stamp_age_s, self.pixels, self.opened = stamp_age_s, pixels, opened
        self.released = False

    def __call__(self, number, backend):
        assert (number, backend) == (0, cv2.CAP_V4L2)
        return self

    def isOpened(self):  # noqa: N802
        return self.opened

    def set(self, key, value):  # noqa: A003
        self.order.append(key)
        if key not in self.fixed:
            self.values[key] = float(value)

    def get(self, key):
        if key == P.CAP_PROP_POS_MSEC:
            return 0.0 if self.stamp_age_s is None else 1e3 * (time.monotonic()
                                                               - self.stamp_age_s)
        return self.fixed.get(key, self.values.get(key, -1.0))

    def grab(self):
        return True

    def retrieve(self):
        return True, np.zeros((480, 640, 3), np.uint8) if self.pixels is None else self.pixels

    def release(self):
        self.released = True


def opened(capture, **options):
    return V4l2Camera(CaptureOptions(**options), capture)


def test_all_settings_are_set_and_read_back():
    capture = FakeCapture()
    camera = opened(capture, width=1280, height=720, frame_rate_hz=5.0, exposure_ms=180.0,
                    gain=64.0, pixel_format='GREY')
    assert camera.problems == [] and camera.name == '/dev/video0'
    assert capture.values[P.CAP_PROP_FRAME_WIDTH] == 1280 and capture.values[P.CAP_PROP_FPS] == 5
    assert capture.values[P.CAP_PROP_EXPOSURE] == 1800 and capture.values[P.CAP_PROP_GAIN] == 64
    assert capture.values[P.CAP_PROP_AUTO_EXPOSURE] == 1
    # A new format or size sets the conversion back.
    assert capture.order.index(P.CAP_PROP_CONVERT_RGB) > max(
        map(capture.order.index, (P.CAP_PROP_FOURCC, P.CAP_PROP_FRAME_HEIGHT, P.CAP_PROP_FPS)))
    assert capture.order.index(P.CAP_PROP_EXPOSURE) > capture.order.index(
        P.CAP_PROP_AUTO_EXPOSURE)
    untouched = FakeCapture()
    opened(untouched)
    assert untouched.order == []


@pytest.mark.parametrize('fixed, options, text', [
    ({P.CAP_PROP_EXPOSURE: 333.0}, {'exposure_ms': 200.0}, 'exposure_ms is 33.3, not 200'),
    ({P.CAP_PROP_AUTO_EXPOSURE: 3.0}, {'exposure_ms': 15.6}, 'manual exposure is 3, not 1'),
    ({P.CAP_PROP_GAIN: -1.0}, {'gain': 10.0}, 'gain cannot be set'),
    ({P.CAP_PROP_FPS: 30.0}, {'frame_rate_hz': 5.0}, 'frame_rate_hz is 30, not 5'),
    ({P.CAP_PROP_FRAME_WIDTH: 800.0}, {'width': 1280, 'height': 480}, 'width is 800, not 1280'),
    ({P.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*'MJPG'))}, {'pixel_format': 'Y16'},
     'pixel_format is MJPG'),
    ({}, {'width': 1280}, 'together')])
def test_a_setting_that_the_camera_ignores_is_named(fixed, options, text):
    assert any(text in problem for problem in opened(FakeCapture(fixed), **options).problems)


def test_the_stamp_is_the_middle_of_the_exposure(monkeypatch):
    now_s, now_ns = time.monotonic(), time.time_ns()
    monkeypatch.setattr(time, 'monotonic', lambda: now_s)
    monkeypatch.setattr(time, 'time_ns', lambda: now_ns)

    def check(fixed, stamp_age_s, exposure_ms, age_s, error_s, source):
        captured = opened(FakeCapture(fixed, stamp_age_s), exposure_ms=exposure_ms).read()
        assert captured.stamp_from == source
        assert (now_ns - captured.stamp_ns) * 1e-9 == pytest.approx(age_s, abs=1e-6)
        assert captured.stamp_error_s == pytest.approx(error_s)
    check({}, 0.4, 100.0, 0.45, 0.075, 'driver')
    # No stamp, one of another clock, one of the future: the arrival, a period later at most.
    for stamp_age_s in (None, 1000.0, -50.0):
        check({}, stamp_age_s, 100.0, 0.05, 0.1, 'arrival')
    # An automatic exposure is anything up to the period of 50 ms.
    check({}, 0.4, 0.0, 0.4125, 0.05, 'driver')
    # The exposure that the camera has, not the one that was asked for.
    check({P.CAP_PROP_EXPOSURE: 400.0}, 0.4, 1000.0, 0.42, 0.045, 'driver')


def test_a_change_is_that_not_of_the_images_exposed_already(monkeypatch):
    capture = FakeCapture(None, 0.4)
    camera = opened(capture, exposure_ms=20.0)
    first = camera.read()
    assert first.setting == Setting(20.0, 5.0)
    camera.change(Setting(40.0, 7.0))
    assert capture.values[P.CAP_PROP_EXPOSURE] == 400 and capture.values[P.CAP_PROP_GAIN] == 7
    found = [camera.read() for _ in range(4)]
    assert [one.setting for one in found] == [None, None, None, Setting(40.0, 7.0)]
    # Either of both exposures, for the images in between.
    assert found[0].stamp_error_s == pytest.approx(found[3].stamp_error_s + 0.01)
    camera.change(Setting(40.0, -1.0))
    assert capture.values[P.CAP_PROP_GAIN] == 7
    fixed = opened(FakeCapture({P.CAP_PROP_EXPOSURE: -1.0}))
    fixed.change(Setting(40.0, -1.0))
    fixed.change(Setting(20.0, -1.0))
    assert fixed.problems == ['exposure_ms cannot be set']


def test_raw_buffers_become_images():
    rng = np.random.default_rng(3)
    image = rng.integers(0, 1024, (480, 640)).astype('<u2')
    # As OpenCV returns formats that it does not know: one row of bytes, here with padding.
    padded = np.zeros((480, 700), '<u2')
    padded[:, :640] = image
    flat = padded.view(np.uint8).reshape(1, -1)
    np.testing.assert_array_equal(
        opened(FakeCapture(pixels=flat), pixel_format='Y12').read().image, image)
    np.testing.assert_array_equal(
        opened(FakeCapture(pixels=image), pixel_format='Y16').read().image, image)
    mosaic = opened(FakeCapture(pixels=flat), pixel_format='RG10').read().image
    assert mosaic.dtype == np.uint16
    cells = image.reshape(240, 2, 320, 2).mean((1, 3))
    assert np.abs(mosaic - cells).max() <= 0.5
    colours = rng.integers(0, 255, (480, 640, 3)).astype(np.uint8)
    np.testing.assert_array_equal(opened(FakeCapture(pixels=colours)).read().image,
                                  colours.mean(axis=2).round().astype(np.uint8))


def test_a_device_that_is_invalid_is_named(tmp_path):
    for device, text in (('/dev/video97', 'no such camera; there '), ('97', '/dev/video97: no'),
                         ('/dev/null', '/dev/null: no camera of Video4Linux'),
                         (str(tmp_path / 'a.mkv'), 'a.mkv: no such file')):
        with pytest.raises(CaptureError, match=text):
            open_device(CaptureOptions(device=device))


def write_images(folder, count, name='{}.png'):
    images = np.random.default_rng(1).integers(0, 255, (count, 24, 32)).astype(np.uint8)
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / name.format(number)), image)
    return images


@pytest.mark.parametrize('device', ['', '*.png'])
def test_files_come_at_their_pace_with_their_stamps(tmp_path, device):
    images = write_images(tmp_path, 3)
    waits = []
    files = open_device(CaptureOptions(device=str(tmp_path / device), frame_rate_hz=4.0),
                        waits.append)
    begin_ns = time.time_ns()
    found = [files.read() for _ in range(3)]
    np.testing.assert_array_equal([one.image for one in found], images)
    np.testing.assert_allclose(np.diff([one.stamp_ns for one in found]), 250_000_000)
    assert abs(found[0].stamp_ns - begin_ns) < 0.2e9 and found[0].stamp_from == 'file'
    assert waits[0] == 0 and waits[2] == pytest.approx(0.5, abs=0.2)
    assert files.read() is None and files.ends
    files.close()


class Script:
    """Devices one after the other: an error, or a number of images before the loss."""

    def __init__(self, *devices):
        self.devices = list(devices)
        self.closed = 0

    def __call__(self, options, wait):
        following = self.devices.pop(0)
        if isinstance(following, Exception):
            raise following
        self.name, self.ends, self.problems, self.left = 'it', False, ['slow'], following
        self.period_s = 0.1
        return self

    def read(self):
        if self.left == 0:
            return None
        self.left -= 1
        return Captured(np.zeros((2, 2), np.uint8), 0, 'file', 0.0)

    def close(self):
        self.closed += 1


def wait_for(condition):
    deadline_s = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def test_a_lost_device_is_opened_again(monkeypatch):
    monkeypatch.setattr('startracker_ros.io.images.capture._FIRST_WAIT_S', 0.01)
    script = Script(CaptureError('device it: not there'), 3, 0, 2, 10 ** 9)
    images = []
    thread = CaptureThread(CaptureOptions(), lambda: images.append(thread.newest()), script)
    thread.start()
    wait_for(lambda: len(images) > 10)
    assert thread.state.name == CAPTURING and thread.problems == ['slow']
    assert thread.losses == 2 and script.closed == 3
    thread.stop()
    assert not thread.running and script.closed == 4


def test_a_loss_is_reported_until_it_is_fixed(monkeypatch):
    script = Script(1, CaptureError('device it: not there'))
    thread = CaptureThread(CaptureOptions(), lambda: None, script)
    monkeypatch.setattr('startracker_ros.io.images.capture._FIRST_WAIT_S', 30.0)
    thread.start()
    wait_for(lambda: thread.state.name == LOST)
    assert thread.state.text == 'device it gives no more images: it is opened again'
    # The wait of half a minute ends at once.
    thread.stop()
    assert not thread.running


def test_a_driver_that_sends_nothing_is_a_loss(monkeypatch):
    thread = CaptureThread(CaptureOptions(), lambda: None, Script(10 ** 9))
    thread.start()
    wait_for(lambda: thread.state.name == CAPTURING)
    thread.stop()
    assert thread.state.name == CAPTURING
    monkeypatch.setattr('startracker_ros.io.images.capture._SILENT_S', -1.0)
    monkeypatch.setattr('startracker_ros.io.images.capture._SILENT_PERIODS', -1.0)
    assert thread.state.name == LOST and 'no image for' in thread.state.text


def test_images_that_nobody_fetches_are_dropped_and_the_end_is_not_a_loss(tmp_path):
    write_images(tmp_path, 5)
    thread = CaptureThread(CaptureOptions(device=str(tmp_path), frame_rate_hz=1000.0),
                           lambda: None)
    thread.start()
    wait_for(lambda: thread.state.name == ENDED)
    assert thread.dropped == 4 and thread.losses == 0
    assert thread.newest() is not None and thread.newest() is None
    (tmp_path / '2.png').write_bytes(b'no image')
    thread = CaptureThread(CaptureOptions(device=str(tmp_path), frame_rate_hz=1000.0),
                           lambda: None)
    thread.start()
    wait_for(lambda: thread.state.name == FAILED)
    assert '2.png' in thread.state.text
