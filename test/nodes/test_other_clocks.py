# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras whose driver does not stamp in UTC: attitudes that hold, and the clock by name."""

from pathlib import Path
import time

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
import numpy as np
import pytest
from queues import deep_queues
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Imu
from shifted_bags import GPS_NS, mosaic, write_shifted
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)
from startracker_ros.ros.messages.header import make_header, stamp_from_ns
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.ros.messages.message_types import message_class

BAG = Path(__file__).parents[2] / 'bags' / 'slew'


def truth_by_stamp(shift_ns):
    return {ns_from_stamp(message.header.stamp) - shift_ns: quaternion_from_message(message)
            for message in (deserialize_message(record.data, message_class(record.type_name))
                            for record in read_messages(BAG, topics=('/truth/attitude',)))}


def assert_they_hold(answers, bounds, truth):
    """Check attitudes against their covariances and bounds, which are no larger than needed."""
    assert answers.keys() <= bounds.keys() and answers.keys() <= truth.keys()
    sigma_arcsec = []
    for stamp_ns, attitude in answers.items():
        error = np.abs(attitude_error(attitude.quaternion, truth[stamp_ns]))
        sigma = np.sqrt(np.diag(attitude.covariance_sensor))
        assert (error < 5 * sigma).all() and (error < bounds[stamp_ns]).all(), stamp_ns
        sigma_arcsec.append(sigma[:2] / ARCSEC)
    # That of the velocity of the Earth, and no more.
    assert np.min(sigma_arcsec) > 12 and np.median(sigma_arcsec) < 15


def answers_and_bounds(probe):
    """Return the attitudes that the probe has received, and their protection levels, by stamp."""
    return ({ns_from_stamp(m.header.stamp): tracked_attitude_from_imu(m).attitude
             for m in probe.received['attitude_imu'] if m.orientation_covariance[0] >= 0},
            {ns_from_stamp(m.header.stamp): np.array([m.vector.x, m.vector.y, m.vector.z])
             for m in probe.received['protection_level']})


@pytest.mark.parametrize('clock', ['boot', 'gps'])
def test_attitudes_hold_and_the_clock_is_named(nodes, probe, tmp_path, clock):
    """In a process each since boot; composed, of a Bayer camera that receives GPS."""
    first_ns = min(truth_by_stamp(0))
    shift_ns = first_ns - (100 * 10 ** 9 if clock == 'boot' else time.time_ns() - GPS_NS)
    probe.collect(Imu, 'attitude_imu', 100)
    probe.collect(Vector3Stamped, 'protection_level', 100)
    player = nodes.start('bag_player', {
        'path': str(write_shifted(BAG, tmp_path / 'bag', shift_ns,
                                  mosaic if clock == 'gps' else None)),
        'wait_for_camera_users': 4, 'wait_limit_s': 300.0, 'start_delay_s': 2.0})
    for name in STAGES if clock == 'boot' else ('composed_pipeline',):
        nodes.start(name, {'autostart': False} | deep_queues('image_raw.subscription'))
    nodes.start('pipeline_manager')
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    truth = truth_by_stamp(shift_ns)
    probe.wait(lambda: len(probe.received['attitude_imu']) == len(truth), 'all answers')
    answers, bounds = answers_and_bounds(probe)
    assert len(answers) > 30
    assert_they_hold(answers, bounds, truth)
    named = ('the driver stamps since boot, not UTC: let it stamp in UTC' if clock == 'boot' else
             'the driver stamps in GPS time')
    for node in ('star_tracker', 'attitude_estimator'):
        probe.wait(lambda node=node: probe.find_diagnostic(named, node=node), named)

    # A driver that does not stamp at all is not one of two that disagree.
    probe.forget()
    image = probe.advertise(Image, 'image_raw', qos.IMAGE)
    unstamped = image_to_message(np.full((512, 512), 7, np.uint16), make_header(0, ''))
    probe.send_until(lambda: image.publish(unstamped), lambda: probe.find_diagnostic(
        'image_raw: stamp 0: the driver does not stamp'), 'what the driver does not')
    assert not probe.find_diagnostic('out of order')


def test_a_simulation_that_begins_at_zero(nodes, probe):
    """With aberration of an unknown date: /clock and stamps from 0 on."""
    probe.collect(Imu, 'attitude_imu', 100)
    probe.collect(Vector3Stamped, 'protection_level', 100)
    probe.collect(QuaternionStamped, 'truth/attitude', 100)
    clock = probe.create_publisher(Clock, '/clock', 10)
    nodes.start('composed_pipeline', {'use_sim_time': True})
    nodes.start('sky_simulator', {
        'use_sim_time': True, 'width': 512, 'height': 512, 'wait_for_camera_users': 4})
    now_ns = 0

    def tick():
        nonlocal now_ns
        clock.publish(Clock(clock=stamp_from_ns(now_ns)))
        now_ns += 50_000_000
    probe.send_until(tick, lambda: len(answers_and_bounds(probe)[0]) > 20, 'attitudes',
                     period_s=0.02)
    answers, bounds = answers_and_bounds(probe)
    truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
             for message in probe.received['truth/attitude']}
    # The last frame may be on its way on one of the topics.
    assert_they_hold({stamp_ns: answers[stamp_ns] for stamp_ns in sorted(
        answers.keys() & bounds.keys() & truth.keys())[:20]}, bounds, truth)
    assert max(answers) < 3600 * 10 ** 9
    probe.wait_diagnostic('a simulation may begin at a date')
