# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sub_frame_attitude over DDS: 160 attitudes a second out of ten frames of a rolling shutter."""

from dataclasses import replace

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import FRAME
from startracker_evaluation.campaign.integrity_motion import (
    attitudes, by_rows, LINE_TIME_S, MotionCondition, onboard_stars)
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import attitude_error, matrix_from_quaternion
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.tools.datasheet.tally import CAMERA, START_NS

SUB_FRAMES, FRAMES, STEP_NS = 16, 40, 100_000_000
SWAY = MotionCondition('sway', 0.2, 2.0, steady_deg_s=3.0)


def stamp_of(message):
    return ns_from_stamp(message.header.stamp)


@pytest.fixture(scope='module')
def received(shared_rig):
    """Return the frames with an attitude, the sub-frames, and the function of the truth."""
    nodes, probe = shared_rig.processes, shared_rig.probe
    nodes.start('star_identifier', {})
    nodes.start('star_tracker', {'aberration': 'none'})
    nodes.start('attitude_estimator', {'aberration': 'none', 'sub_frames': SUB_FRAMES})
    probe.collect(Imu, 'attitude_imu', qos.LIST)
    probe.collect(PointCloud2, 'stars', qos.LIST)
    probe.collect(Imu, 'sub_frame_attitude', qos.IMU)
    lists = probe.advertise(PointCloud2, 'centroids', qos.LIST, subscribers=2)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=3)
    probe.publish_until_received(
        info, camera_to_message(CAMERA, make_header(START_NS, FRAME)), nodes=3)
    probe.wait(lambda: all(probe.count_publishers(topic) and probe.count_subscribers(topic)
                           for topic in ('stars', 'tracks', 'tracked_attitude',
                                         'tracked_acceleration')), 'all nodes')
    probe.publish_until_received(lists, centroids_to_message(
        Centroids.empty(), CAMERA, make_header(START_NS - 10 * STEP_NS, FRAME)), nodes=2)
    rng = np.random.default_rng(4)
    attitude = attitudes(SWAY, rng, FRAMES)
    answers, stars = probe.received['attitude_imu'], probe.received['stars']
    for frame in range(FRAMES):
        time_s, stamp_ns = (frame + 1) * 0.1, START_NS + frame * STEP_NS
        seen, hip = star_list(onboard_stars(), CAMERA, attitude(np.array([time_s]))[0], 0.1, rng)
        lists.publish(centroids_to_message(
            replace(by_rows(seen, hip, attitude, time_s, LINE_TIME_S), exposure_s=(0.0, 0.0)),
            CAMERA, make_header(stamp_ns, FRAME)))
        probe.wait(lambda stamp_ns=stamp_ns: answers and stamp_of(answers[-1]) == stamp_ns,
                   f'the answer to frame {frame}')
        # A frame without an attitude waits for its identification.
        probe.wait(lambda stamp_ns=stamp_ns: answers[-1].orientation_covariance[0] >= 0
                   or stars and stamp_of(stars[-1]) >= stamp_ns,
                   f'the identification of frame {frame}')
    known = {stamp_of(message) for message in answers
             if message.orientation_covariance[0] >= 0}
    # Before the first attitude no interval is known.
    probe.wait(lambda: len(probe.received['sub_frame_attitude']) >= SUB_FRAMES * (len(known) - 1),
               'the sub-frames')
    return known, probe.received['sub_frame_attitude'], (
        lambda stamp_ns: attitude(np.array([0.1 + (stamp_ns - START_NS) * 1e-9]))[0])


def test_each_frame_gives_so_many_attitudes_of_their_own_times(received):
    known, messages, _ = received
    stamps_ns = [stamp_of(message) for message in messages]
    assert len(known) >= 0.9 * FRAMES
    steps_ns = np.diff(stamps_ns)
    assert (steps_ns > 0).all() and np.median(steps_ns) == STEP_NS / SUB_FRAMES
    assert {message.header.frame_id for message in messages} == {FRAME}
    assert len(messages) == SUB_FRAMES * (len(known) - 1)


def test_they_are_those_of_the_body_at_these_times(received):
    _, messages, truth = received
    squares, arcsec = [], []
    for message in messages[5 * SUB_FRAMES:]:
        found = tracked_attitude_from_imu(message)
        error = attitude_error(found.attitude.quaternion, truth(stamp_of(message)))
        P = found.attitude.covariance_sensor
        squares.append(error @ np.linalg.solve(P, error))
        assert (np.abs(error) < 5 * np.sqrt(np.diag(P))).all()
        arcsec.append(np.degrees(np.hypot(*error[:2])) * 3600)
    # Where the correlation of attitude and rate is not known the covariance is a bound.
    assert 0.5 < np.mean(squares) < 3.8
    # The body moves by 60 arcsec and more between two sub-frames.
    assert np.median(arcsec) < 3


def test_the_axes_of_the_covariance_are_those_of_icrf(received):
    message = received[1][-1]
    found = tracked_attitude_from_imu(message)
    R = matrix_from_quaternion(found.attitude.quaternion)
    np.testing.assert_allclose(
        R @ found.attitude.covariance_sensor @ R.T,
        np.reshape(message.orientation_covariance, (3, 3)), rtol=1e-9, atol=1e-18)
