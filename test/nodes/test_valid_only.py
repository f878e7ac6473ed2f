# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""attitude_imu with and without the frames that have no attitude."""

from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import FRAME, onboard_stars, SMALL_CAMERA as CAMERA, START_NS, synthetic_field
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos, tables
from startracker_ros.ros.messages.clouds import stars_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
import yaml

STEP_NS = 100_000_000
IDENTIFIED = (True, False, False, True)
EXAMPLE = Path(__file__).parents[2] / 'docs' / 'examples' / 'robot_localization.yaml'


@pytest.mark.parametrize('valid_only', [False, True])
def test_frames_without_an_attitude_are_held_back_on_request(nodes, probe, valid_only):
    nodes.start('attitude_estimator', {
        'source': 'stars', 'aberration': 'none', 'attitude_imu_valid_only': valid_only})
    probe.collect(Imu, 'attitude_imu', qos.LIST)
    stars = probe.advertise(PointCloud2, 'stars', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, make_header(START_NS, FRAME)))
    probe.wait(lambda: probe.count_publishers('attitude_imu'), 'the publisher')
    centroids, hip = synthetic_field(onboard_stars(CAMERA, 2026.0), CAMERA)
    zeros = np.zeros(len(hip))
    clouds = [stars_to_message(
        centroids, hip if identified else np.zeros_like(hip), zeros, zeros, CAMERA,
        make_header(START_NS + index * STEP_NS, FRAME))
        for index, identified in enumerate(IDENTIFIED)]
    # The first one until it is received, then no more is lost.
    probe.publish_until_received(stars, clouds[0])
    for cloud in clouds[1:]:
        stars.publish(cloud)
    last_ns = START_NS + (len(IDENTIFIED) - 1) * STEP_NS
    received = probe.received['attitude_imu']
    probe.wait(lambda: received and ns_from_stamp(received[-1].header.stamp) == last_ns,
               'the last frame')
    expected = [identified for identified in IDENTIFIED if identified or not valid_only]
    assert [message.orientation_covariance[0] >= 0 for message in received] == expected
    probe.wait_diagnostic('no attitude')


def test_the_example_names_topics_and_frames_that_exist():
    ekf, = yaml.safe_load(EXAMPLE.read_text()).values()
    parameters = ekf['ros__parameters']
    assert parameters['imu0'] == 'attitude_imu' and len(parameters['imu0_config']) == 15
    defaults = {row.name: row.default for row in tables.node_rows('attitude_estimator')}
    assert parameters['world_frame'] == defaults['inertial_frame_id']
    # The attitude has the frame of the images.
    assert defaults['sensor_frame_id'] == ''
    assert parameters['base_link_frame'] == {
        row.name: row.default for row in tables.node_rows('camera_source')}['sensor_frame_id']
    assert 'attitude_imu_valid_only' in defaults and (
        'attitude_imu_valid_only: true' in EXAMPLE.read_text())
