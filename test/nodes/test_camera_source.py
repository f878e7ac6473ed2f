# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""camera_source with files in place of a camera: waits for them, publishes, ends, changes."""

import time
from types import SimpleNamespace

import cv2
from limits import HANGS_S
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, TimeReference
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.exposure.control import Setting
from startracker_ros.io.bags.layouts import camera_from_message, image_from_message, ns_from_stamp
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.io.images.capture import Captured
from startracker_ros.ros import qos
from startracker_ros.ros.nodes.camera_source import CameraSourceNode


def write(folder, shape):
    part = folder.with_suffix('.part')
    part.mkdir()
    images = np.random.default_rng(1).integers(0, 65535, (6, *shape)).astype(np.uint16)
    for number, image in enumerate(images):
        cv2.imwrite(str(part / f'{number}.png'), image)
    part.rename(folder)
    return images


def test_a_device_that_comes_later_ends_and_is_replaced(rig, probe, tmp_path):
    camera = Camera(64, 48, 300.0, 301.0, 30.0, 25.0, (0.1, 0.0, 0.0, 0.0, 0.0))
    save_camera(camera, tmp_path / 'camera.yaml')
    for message_type, topic, profile in ((Image, 'image_raw', qos.IMAGE),
                                         (CameraInfo, 'camera_info', qos.LIST)):
        probe.collect(message_type, topic, profile)
    rig.processes.start('camera_source', {
        'device': str(tmp_path / 'images'), 'camera_file': str(tmp_path / 'camera.yaml'),
        'frame_rate_hz': 5.0})
    probe.wait_diagnostic('images: no such file')
    assert not probe.received['image_raw']
    (tmp_path / 'images').mkdir()
    probe.wait_diagnostic('gives no images')
    images = write(tmp_path / 'images', (48, 64))
    probe.wait_diagnostic('all images of')
    messages, infos = probe.received['image_raw'], probe.received['camera_info']
    probe.wait(lambda: messages and infos and infos[-1].header == messages[-1].header,
               'the last image and its camera_info')
    # A busy process may have dropped some.
    shown = [next(number for number, image in enumerate(images)
                  if np.array_equal(image_from_message(message).pixels, image))
             for message in messages]
    assert shown == sorted(set(shown)) and messages[0].encoding == 'mono16'
    stamps_ns = np.array([ns_from_stamp(message.header.stamp) for message in messages])
    np.testing.assert_allclose(np.diff(stamps_ns), 200_000_000 * np.diff(shown), atol=1)
    assert camera_from_message(infos[-1]) == camera
    assert probe.diagnostic_value('camera_source: camera', 'stamp_from') == 'file'

    def change(name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return probe.call(SetParameters, '/camera_source/set_parameters', request).results[0]
    # Another device, whose images are not those of the camera file.
    write(tmp_path / 'others', (32, 32))
    probe.forget()
    assert change('device', str(tmp_path / 'others' / '*.png')).successful
    probe.wait_diagnostic('images of 32 x 32 px, camera_file has 64 x 48')
    assert not probe.received['image_raw']
    assert not change('camera_file', str(tmp_path / 'none.yaml')).successful
    assert change('camera_file', '').successful
    probe.wait(lambda: probe.received['image_raw'] and probe.received['camera_info'],
               'an image with the ideal camera')
    assert camera_from_message(probe.received['camera_info'][-1]).width == 32


def test_a_wrong_camera_file_stops_the_node(rig, tmp_path):
    process = rig.processes.start('camera_source', {'camera_file': str(tmp_path / 'none.yaml')})
    assert process.wait(HANGS_S) == 2
    assert 'none.yaml' in (tmp_path / 'camera_source.log').read_text()
    rig.processes.processes.clear()


@pytest.fixture
def node():
    rclpy.init()
    node = CameraSourceNode()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_exposure_and_gain_are_reported_as_far_as_they_are_known(node):
    image, values = np.zeros((4, 4), np.uint8), node.diagnostics.values
    node._report(Captured(image, 0, 'driver', 0.0))
    assert 'exposure_ms' not in values and values['stamp_from'] == 'driver'
    node._report(Captured(image, 0, 'driver', 0.0, Setting(199.96, 64.0)))
    # One of those after a change, whose setting is not known.
    node._report(Captured(image, 0, 'driver', 0.0))
    assert (values['exposure_ms'], values['gain']) == ('200', '64')
    node.deactivate()
    assert not values


def test_an_exposure_that_is_known_is_published_before_its_image(node):
    """The stand-in is the capture; files say no exposure time."""
    received = []
    for kind, topic, profile in ((TimeReference, 'exposure_start', qos.LIST),
                                 (Image, 'image_raw', qos.IMAGE)):
        node.create_subscription(kind, topic, received.append, profile)
    stamp_ns, pixels = 1_767_225_600_250_000_000, np.zeros((480, 640), np.uint8)
    captured = [Captured(pixels, stamp_ns, 'driver', 0.0, Setting(199.96, 64.0)),
                Captured(pixels, stamp_ns + 250_000_000, 'driver', 0.0)]
    node.rebuild()
    node.trigger_configure()
    node.trigger_activate()
    node._capture.stop()
    node._capture = SimpleNamespace(newest=lambda: captured.pop(0), stop=lambda: None)
    begin_s = time.monotonic()
    for _ in range(2):
        node._publish()
    while len(received) < 3 and time.monotonic() < begin_s + HANGS_S:
        rclpy.spin_once(node, timeout_sec=0.1)
    exposure, = (one for one in received if isinstance(one, TimeReference))
    images = [one for one in received if isinstance(one, Image)]
    assert exposure.header == images[0].header and len(images) == 2
    assert exposure.source == 'exposure'
    assert ns_from_stamp(exposure.time_ref) == stamp_ns - 99_980_000
