# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the two nodes that make images promise of their pace and of their files."""

from dataclasses import replace
import signal
import time
from typing import Any

import cv2
import numpy as np
import pytest
from queues import deep_queues
from sensor_msgs.msg import CameraInfo, Image, Imu
from sensor_msgs.srv import SetCameraInfo
from startracker_ros.io.bags.layouts import camera_from_message, image_from_message, ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.source import ANSWER_LIMIT_S
from std_msgs.msg import Header


STOPPED_S = 3.0


def test_a_source_makes_up_for_the_time_that_it_stood_still(nodes, probe):
    probe.collect(CameraInfo, 'camera_info', qos.LIST)
    source = nodes.start('sky_simulator', {
        'width': 64, 'height': 64, 'frame_rate_hz': 10.0,
        **deep_queues('camera_info.publisher')})
    heard = probe.received['camera_info']
    probe.wait(lambda: len(heard) >= 10, 'images')
    source.send_signal(signal.SIGSTOP)
    time.sleep(STOPPED_S)
    source.send_signal(signal.SIGCONT)
    probe.wait(lambda: time.time() - ns_from_stamp(heard[-1].header.stamp) * 1e-9 < STOPPED_S / 2,
               'an image that is not late')
    steps_ns = np.diff([ns_from_stamp(message.header.stamp) for message in heard])
    assert np.abs(steps_ns - 100_000_000).max() <= 1, 'none is left out'
    # A calibrated camera replaces that of the parameters; an impossible one does not.
    camera = camera_from_message(heard[-1])
    better = camera.with_focal_ratio(1.001)
    for message, words in (
            (camera_to_message(replace(better, width=65), Header()), 'images have 64 x 64 px'),
            (CameraInfo(width=64, height=64, k=[float('nan')] * 9), 'NaN'),
            (CameraInfo(width=64, height=64, k=np.eye(3).ravel()), 'focal length 1, 1 px')):
        answer = probe.call(SetCameraInfo, 'set_camera_info', SetCameraInfo.Request(
            camera_info=message))
        assert not answer.success and words in answer.status_message
    assert probe.call(SetCameraInfo, 'set_camera_info', SetCameraInfo.Request(
        camera_info=camera_to_message(better, Header()))).success
    probe.wait(lambda: camera_from_message(heard[-1]) == better, 'the calibrated camera')


@pytest.mark.parametrize('to_the_limit', [False, pytest.param(True, marks=pytest.mark.long)])
def test_images_wait_for_the_attitudes_of_a_slow_pipeline(nodes, probe, to_the_limit):
    probe.collect(CameraInfo, 'camera_info', qos.LIST)
    probe.collect(Image, 'image_raw', qos.IMAGE)
    answers = probe.create_publisher(Imu, 'attitude_imu', qos.LIST)
    nodes.start('sky_simulator', {
        'width': 64, 'height': 64, 'frame_rate_hz': 10.0, 'frames_ahead': 3,
        'wait_for_camera_users': 1})
    probe.wait(lambda: answers.get_subscription_count(), 'the simulator')
    heard = probe.received['camera_info']

    def frames() -> int:
        return int(probe.diagnostic_value('sky_simulator: simulation', 'frames') or 0)

    def images_without_more(count: int) -> list[int]:
        """Return the stamps of so many images once there is time for more."""
        probe.wait(lambda: frames() >= count, f'{count} images')
        published = len(probe.diagnostics)
        probe.wait(lambda: len(probe.diagnostics) >= published + 10, 'the time of some more')
        assert frames() == count
        return sorted({ns_from_stamp(message.header.stamp) for message in heard})[-count:]
    for count, answered in ((3, 0), (4, 2)):
        images = images_without_more(count)
        answers.publish(Imu(header=Header(stamp=stamp_from_ns(images[answered]))))
    images = images_without_more(6)
    steps_ns = np.diff(images)
    assert np.abs(steps_ns - 100_000_000).max() <= 1, 'the stamps keep the rate'
    # What was lost on its way is not waited for without end.
    if to_the_limit:
        probe.wait_diagnostic(f'no answer to the last image for {ANSWER_LIMIT_S:g} s')
        assert frames() > 6


def test_looped_files_are_read_again_when_they_change(nodes, probe, tmp_path):
    folder = tmp_path / 'images'
    folder.mkdir()
    cv2.imwrite(str(folder / 'a.png'), np.full((32, 32), 10, np.uint8))
    cv2.imwrite(str(folder / 'b.png'), np.full((32, 32), 20, np.uint8))
    probe.collect(Image, 'image_raw', qos.IMAGE)
    nodes.start('image_publisher', {'path': str(folder), 'loop': True, 'frame_rate_hz': 20.0})

    def levels():
        return [int(image_from_message(message).pixels[0, 0])
                for message in probe.received['image_raw']]
    probe.wait(lambda: {10, 20} <= set(levels()), 'both images')
    before = len(levels())
    probe.wait(lambda: len(levels()) >= before + 6, 'more images')
    assert set(levels()[before:]) == {10, 20}
    cv2.imwrite(str(tmp_path / 'new.png'), np.full((32, 32), 30, np.uint8))
    (tmp_path / 'new.png').rename(folder / 'b.png')
    probe.wait(lambda: 30 in levels(), 'the new image')
    (folder / 'b.png').unlink()
    probe.wait_diagnostic('b.png: No such file')


def test_another_camera_is_told_of_before_its_first_image(nodes, probe, tmp_path):
    for name, width in (('a', 32), ('b', 32), ('c', 48)):
        cv2.imwrite(str(tmp_path / f'{name}.png'), np.full((32, width), 10, np.uint8))
    sent = {CameraInfo: {}, Image: {}}

    def note(message: Any, info: dict[str, int]) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        sent[type(message)][stamp_ns] = info['source_timestamp'], message.width
    probe.subscribe_with_info(CameraInfo, 'camera_info', note, qos.LIST)
    probe.subscribe_with_info(Image, 'image_raw', note, qos.IMAGE)
    nodes.start('image_publisher', {'path': str(tmp_path), 'loop': True, 'frame_rate_hz': 10.0,
                                    'wait_for_subscribers': 1, 'wait_for_camera_users': 1})

    def checked():
        """Return for all pairs of images that are known whether the camera was another one."""
        found = []
        for stamp_ns in sent[Image].keys() & sent[CameraInfo].keys():
            (image_ns, width), (info_ns, info) = sent[Image][stamp_ns], sent[CameraInfo][stamp_ns]
            assert info == width
            if stamp_ns - 100_000_000 in sent[Image]:
                another = width != sent[Image][stamp_ns - 100_000_000][1]
                assert (info_ns < image_ns) == another
                found.append(another)
        return found
    # Each third image is wider, and the one after it is not.
    probe.wait(lambda: checked().count(True) >= 3 and checked().count(False) >= 2, 'images')
