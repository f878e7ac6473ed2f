# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sky_simulator along the motion of a topic: lock-step, interpolated, and topics that go wrong."""

from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from skies import START_NS
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.odometry import motion_to_odometry

SENSOR = 'star_tracker_optical_frame'
STEP_NS = 200_000_000
# Messages that wait for the probe: several images are published at once.
MANY = 100
Q = random_attitude(np.random.default_rng(1))
RATE = np.radians([1.0, -2.0, 0.5])
POSITION, VELOCITY = np.array([7.0e6, 0.0, 0.0]), np.array([0.0, 6.5e3, 3.7e3])


def attitude_at(stamp_ns):
    return multiply(Q, quaternion_from_rotation_vector(RATE * (stamp_ns - START_NS) * 1e-9))


def odometry(stamp_ns, *, frame='icrf', child=SENSOR, rate=RATE, q=None):
    return motion_to_odometry(POSITION, VELOCITY, attitude_at(stamp_ns) if q is None else q, rate,
                              make_header(stamp_ns, frame), child)


class Simulator:
    """A sky_simulator in lock-step, and what it published."""

    def __init__(self, rig):
        self.probe = rig.probe
        for kind, topic, profile in ((Image, 'image_raw', MANY),
                                     (QuaternionStamped, 'truth/attitude', MANY)):
            rig.probe.collect(kind, topic, profile)
        rig.processes.start('sky_simulator', {
            'motion': 'topic', 'lock_step': True, 'width': 64, 'height': 64, 'use_sim_time': True,
            'frame_rate_hz': 20.0, 'wait_for_subscribers': 1, **{
                f'qos_overrides./{topic}.publisher.depth': MANY
                for topic in ('image_raw', 'truth/attitude')}})
        self._motion = rig.probe.advertise(Odometry, 'motion/odometry', qos.LIST)
        self.newest_ns = START_NS

    def send_until(self, messages, condition, what):
        """Publish messages until a condition is true; one that was received makes no image."""
        return self.probe.send_until(
            lambda: [self._motion.publish(message) for message in messages], condition, what)

    def send_until_reported(self, words, *messages):
        self.send_until(messages, lambda: self.probe.find_diagnostic(words), words)

    def stamps_ns(self):
        return [ns_from_stamp(message.header.stamp)
                for message in self.probe.received['image_raw']]

    def send_until_images(self, count, *messages):
        """Publish messages until there are that many images in all."""
        received = self.probe.received
        self.send_until(messages, lambda: min(map(len, (
            received['image_raw'], received['truth/attitude']))) >= count, f'{count} images')

    def count(self, key):
        """Return how often the simulator has counted something."""
        return int(self.probe.diagnostic_value('sky_simulator: simulation', key) or 0)


@pytest.fixture(scope='module')
def simulator(shared_rig):
    return Simulator(shared_rig)


def test_each_message_makes_an_image_at_its_stamp(simulator):
    stamps_ns = [START_NS + index * STEP_NS for index in range(20)]
    for number, stamp_ns in enumerate(stamps_ns, 1):
        simulator.send_until_images(number, odometry(stamp_ns))
    assert simulator.stamps_ns() == stamps_ns
    truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
             for message in simulator.probe.received['truth/attitude']}
    for stamp_ns in stamps_ns:
        assert np.abs(attitude_error(truth[stamp_ns], attitude_at(stamp_ns))).max() < 1e-12
    simulator.newest_ns = stamps_ns[-1]


@pytest.mark.parametrize('change, words', [
    ({'frame': 'map'}, "frame 'map' is not 'icrf'"),
    ({'child': 'base_link'}, f"child frame 'base_link' is not '{SENSOR}'"),
    ({'rate': np.array([0.0, np.nan, 0.0])}, 'position, velocity or rate is not finite'),
    ({'q': np.full(4, np.nan)}, 'is not an attitude'),
    ({'q': np.zeros(4)}, 'is not an attitude')])
def test_a_message_that_is_not_a_motion_makes_no_image(simulator, change, words):
    images = len(simulator.stamps_ns())
    simulator.send_until_reported(words, odometry(simulator.newest_ns + STEP_NS, **change))
    simulator.newest_ns += STEP_NS
    simulator.send_until_images(images + 1, odometry(simulator.newest_ns))
    assert simulator.stamps_ns()[images:] == [simulator.newest_ns]


def test_a_message_out_of_order_makes_no_image(simulator):
    images = len(simulator.stamps_ns())
    before = simulator.count('motion/odometry out of order')
    simulator.send_until(
        [odometry(simulator.newest_ns), odometry(simulator.newest_ns - STEP_NS)],
        lambda: simulator.count('motion/odometry out of order') >= before + 2, 'both counted')
    simulator.newest_ns += STEP_NS
    simulator.send_until_images(images + 1, odometry(simulator.newest_ns))
    assert simulator.stamps_ns()[images:] == [simulator.newest_ns]


def test_a_rate_on_other_axes_is_reported(simulator):
    images = len(simulator.stamps_ns())
    for number in (1, 2):
        simulator.newest_ns += STEP_NS
        simulator.send_until_images(images + number, odometry(simulator.newest_ns, rate=-RATE))
    simulator.probe.wait_diagnostic('the rate is to be on the axes of child_frame_id')


def test_silence_is_reported(simulator):
    simulator.probe.wait_diagnostic('no motion/odometry for')


def test_after_a_jump_back_of_time_the_motion_begins_anew(simulator):
    images = len(simulator.stamps_ns())
    for index in range(3):
        simulator.newest_ns = START_NS + index * STEP_NS
        simulator.send_until_images(images + index + 1, odometry(simulator.newest_ns))
    simulator.probe.wait_diagnostic('time went back by')
    simulator.probe.wait(lambda: simulator.count('motion/odometry restarts') == 1, 'the restart')
    assert simulator.stamps_ns()[images:] == [START_NS + index * STEP_NS for index in range(3)]


def test_without_lock_step_images_come_at_the_frame_rate_in_between(simulator):
    simulator.probe.call(SetParameters, 'sky_simulator/set_parameters', SetParameters.Request(
        parameters=[Parameter('lock_step', value=False).to_parameter_msg()]))
    images = len(simulator.stamps_ns())
    begin_ns = START_NS + 10 * STEP_NS
    # 20 Hz for 1 s, all but the one whose exposure of 0.1 s is not over.
    simulator.send_until_images(images + 20, *(
        odometry(begin_ns + index * STEP_NS) for index in range(6)))
    stamps_ns = simulator.stamps_ns()[images:]
    assert stamps_ns == [begin_ns + index * 50_000_000 for index in range(20)]
    truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
             for message in simulator.probe.received['truth/attitude']}
    for stamp_ns in stamps_ns:
        error = attitude_error(truth[stamp_ns], attitude_at(stamp_ns))
        assert np.abs(error).max() < 1e-6 * ARCSEC
    gap_ns = begin_ns + 60 * STEP_NS
    simulator.send_until_images(images + 22, odometry(gap_ns), odometry(gap_ns + STEP_NS))
    simulator.probe.wait(lambda: simulator.count('motion/odometry gaps') == 1, 'the gap')
    assert min(simulator.stamps_ns()[images + 20:]) >= gap_ns
