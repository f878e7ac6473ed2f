# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Live calibration: photographs through the nodes, a camera YAML out of the service."""

from dataclasses import replace

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, PointCloud2, Temperature
from sensor_msgs.srv import SetCameraInfo
from skies import onboard_stars, START_NS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags.layouts import camera_from_message
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import (
    centroids_to_message, stars_to_message, tracks_to_message)
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from std_srvs.srv import Trigger

CAMERA = Camera.from_fov(1024, 768, 15.0)
ONBOARD = onboard_stars(CAMERA, 2026.7, 6.5)


def call(probe, name):
    return probe.call(Trigger, f'/camera_calibrator/{name}', Trigger.Request())


def value(probe, key):
    """Return the newest value of a key in the diagnostics of the calibrator."""
    found = [item.value for status in probe.statuses() if 'camera_calibrator' in status.name
             for item in status.values if item.key == key]
    return found[-1] if found else None


def header(index):
    return make_header(START_NS + index * 10 ** 8, 'star_tracker_optical_frame')


def test_photographs_give_a_camera(nodes, probe, sky_data, tmp_path):
    output = tmp_path / 'camera.yaml'
    nodes.start('centroid_extractor', {'max_stars': 200})
    nodes.start('star_identifier')
    nodes.start('camera_calibrator', {'output_file': str(output), 'aberration': 'none'})
    probe.wait(lambda: probe.count_publishers('stars') and probe.count_subscribers('stars'),
               'the nodes')
    nodes.start('image_publisher', {
        'path': str(sky_data / 'night-sky-11deg'), 'fov_deg': 11.43, 'frame_rate_hz': 2.0,
        'wait_for_subscribers': 1, 'wait_for_camera_users': 3,
        'start_time_utc': '2019-07-29T20:47:26'})
    probe.wait(lambda: value(probe, 'frames') == '8', 'eight frames')
    assert int(value(probe, 'stars')) > 100
    assert int(value(probe, 'field_covered_percent')) > 50
    answer = call(probe, 'calibrate')
    assert answer.success, answer.message
    assert 'k1 0.1' in answer.message and 'stars in 8 frames' in answer.message
    camera = load_camera(output)
    assert camera.fx == pytest.approx(5113.8, abs=1.5)
    assert 0.05 < camera.distortion[0] < 0.2


def test_what_is_missing_is_said(nodes, probe, tmp_path):
    """No camera, one pointing, a folder that is not there; then the state is forgotten."""
    nodes.start('camera_calibrator', {'output_file': str(tmp_path / 'absent' / 'camera.yaml'),
                                      'max_frames': 4})
    answer = call(probe, 'calibrate')
    assert not answer.success and answer.message == 'no valid camera_info received'
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    stars = probe.advertise(PointCloud2, 'stars', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)))
    rng = np.random.default_rng(1)
    q = random_attitude(rng)
    index = 0

    def send(q):
        nonlocal index
        index += 1
        spots, hip = star_list(ONBOARD, CAMERA, q, 0.1, rng)
        unknown = np.full(len(hip), np.nan)
        stars.publish(stars_to_message(spots, hip, unknown, unknown, CAMERA,
                                       header(index)))
    probe.send_until(lambda: send(q), lambda: int(
        value(probe, 'frames of a pointing already there') or 0) >= 2, 'two refusals')
    answer = call(probe, 'calibrate')
    assert not answer.success and '1 identified images, at least 2' in answer.message
    # Eight pointings, but no more than four are kept.
    for turn in range(1, 9):
        send(multiply(q, quaternion_from_rotation_vector(np.array([0.02 * turn, 0.0, 0.1]))))
    probe.wait(lambda: value(probe, 'stars received') == str(index), 'all frames')
    assert value(probe, 'frames') == '4'
    answer = call(probe, 'calibrate')
    assert not answer.success and 'absent/camera.yaml: No such file' in answer.message
    assert call(probe, 'reset').success
    probe.wait(lambda: value(probe, 'frames') == '0', 'nothing left')
    assert '0 identified images' in call(probe, 'calibrate').message


def tracks_of(hip, uv):
    """Return tracks at pixels (N, 2)."""
    none = np.zeros(len(hip))
    return Tracks(hip, none, uv, none, none, none + 0.1, none, np.arange(len(hip)), none, none,
                  none + 1, np.zeros_like(uv), np.zeros((len(hip), 2, 2)))


def test_a_camera_that_has_changed_in_flight_is_proposed_and_applied(nodes, probe, tmp_path):
    applied = []

    def on_set(request, response):
        applied.append(camera_from_message(request.camera_info))
        response.success = True
        return response
    probe.create_service(SetCameraInfo, 'set_camera_info', on_set)
    output = tmp_path / 'camera.yaml'
    nodes.start('camera_calibrator', {
        'calibration_mode': 'apply', 'output_file': str(output), 'aberration': 'none'})
    probe.collect(CameraInfo, 'proposed_camera_info', qos.STATE)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    topics = [probe.advertise(PointCloud2, name, qos.LIST) for name in ('centroids', 'tracks')]
    temperature = probe.advertise(Temperature, 'temperature', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)))
    rng, truth, index = np.random.default_rng(3), CAMERA.with_focal_ratio(1.0005), 0

    def send(*, change=lambda spots: spots, later=False):
        """Send both clouds of a random pointing; the tracks are those of the camera in use."""
        nonlocal index
        index += 1
        spots, hip = star_list(ONBOARD, truth, random_attitude(rng), 0.1, rng)
        inside = CAMERA.contains(spots.uv)
        spots, hip = spots.select(inside), hip[inside]
        tracks = tracks_to_message(tracks_of(hip, spots.uv + 0.3), CAMERA, header(index))
        clouds = [centroids_to_message(change(spots), CAMERA, header(index)), tracks]
        for topic, cloud in list(zip(topics, clouds))[::-1 if later else 1]:
            topic.publish(cloud)
        probe.spin_for(0.01)

    probe.publish_until_received(temperature, Temperature(temperature=float('nan')))
    probe.wait_diagnostic('nan degC is not a temperature')
    probe.publish_until_received(temperature, Temperature(temperature=21.0))

    def mirrored(spots):
        return replace(spots, uv=spots.uv * [1, -1] + [0, CAMERA.height - 1])

    probe.send_until(
        lambda: send(change=lambda spots: replace(
            spots, uv=spots.uv + rng.normal(0, 1.0, spots.uv.shape))),
        lambda: probe.find_diagnostic('another camera'), 'the frames of another camera',
        period_s=0.0)
    send(change=mirrored)

    def send_both():
        for later in (False, True):
            send(later=later)
    probe.send_until(send_both, lambda: probe.received['proposed_camera_info'] and applied,
                     'the proposal', period_s=0.0)
    camera = camera_from_message(probe.received['proposed_camera_info'][-1])
    assert abs(camera.fx / truth.fx - 1) < 1e-4 and applied[0] == camera
    assert load_camera(output) == camera
    probe.wait_diagnostic('camera proposed: focal changed by up to 0.3')
    # The source has it now: what is estimated of the lens lasts.
    probe.publish_until_received(info, camera_to_message(camera, header(index)))
    probe.wait_diagnostic('another camera: 1024 x 768 px')
    before = int(value(probe, 'tracked frames used'))
    probe.send_until(send, lambda: int(value(probe, 'tracked frames used')) > before,
                     'further frames', period_s=0.1)
    assert value(probe, 'cameras applied') == '1'
    assert len(applied) == 1
