# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes in one process: what goes from hand to hand, and that it is the same pipeline."""

import subprocess

from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.composition import Composition
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_to_imu)
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import publish_value
from startracker_ros.ros.processes import node_command, node_environment
from std_srvs.srv import Trigger

HEADER = make_header(1, 'sensor')
SKY = {'sky_simulator:width': 512, 'sky_simulator:height': 512,
       'sky_simulator:motion': 'constant_rate', 'sky_simulator:rate_deg_s': [0.05, 0.1, 0.02],
       'sky_simulator:wait_for_camera_users': 4}


class Line:
    """A publisher that keeps what DDS would get."""

    def __init__(self, topic, subscribers=0):
        self.topic_name, self.subscribers, self.sent = topic, subscribers, []
        self.msg_type = Imu

    def publish(self, message):
        self.sent.append(message)

    def get_subscription_count(self):
        return self.subscribers


def test_messages_go_from_hand_to_hand_in_the_order_they_were_given():
    composition, order, message = Composition(), [], object()
    first, second = Line('/first'), Line('/second')
    publish_first = composition.advertise(first, False)
    publish_second = composition.advertise(second, False)

    def answer(taken):
        assert taken is message
        order.append('begin')
        publish_second.publish('answer')
        order.append('end')
    composition.subscribe('/first', answer, pytest.fail)
    composition.subscribe('/first', lambda taken: order.append('other'), pytest.fail)
    composition.subscribe('/second', order.append, pytest.fail)
    composition.connect()
    publish_first.publish(message)
    assert order == ['begin', 'end', 'other', 'answer']
    assert publish_first.get_subscription_count() == 2
    assert not first.sent and not second.sent


def test_who_listens_elsewhere_hears_too():
    composition = Composition()
    heard, last = Line('/heard', subscribers=1), Line('/last')
    composition.advertise(heard, False).publish(1)
    composition.advertise(last, True).publish(2)
    assert heard.sent == [1]
    assert last.sent == [2], 'who comes later wants the last message'


def test_a_value_is_serialized_for_other_processes_alone():
    composition, taken, made = Composition(), [], []

    def serialize():
        made.append(True)
        return tracked_attitude_to_imu(None, HEADER)
    here, elsewhere = Line('/here'), Line('/elsewhere', subscribers=1)
    for line in (here, elsewhere):
        composition.subscribe(line.topic_name, taken.append, pytest.fail)
        publish_value(composition.advertise(line, False), HEADER, 'value', serialize)
        assert len(made) == len(line.sent) == line.subscribers
    publish_value(alone := Line('/alone'), HEADER, 'value', serialize)
    assert alone.sent == elsewhere.sent == [serialize()]
    assert [message.value for message in taken] == ['value', 'value']
    assert taken[0].header is HEADER
    # Who does not know the value reads the message.
    assert taken[0].orientation_covariance[0] == -1


def test_who_listens_elsewhere_hears_after_those_here():
    composition, order = Composition(), []
    first, second = Line('/first', subscribers=1), Line('/second', subscribers=1)
    first.publish = second.publish = order.append
    publish_first = composition.advertise(first, False)
    publish_second = composition.advertise(second, False)
    composition.subscribe(
        '/first', lambda taken: publish_second.publish('second out'), pytest.fail)
    composition.subscribe('/second', lambda taken: order.append('second in'), pytest.fail)
    composition.connect()
    publish_first.publish('first out')
    assert order == ['second in', 'first out', 'second out']


def test_what_nobody_waits_for_comes_last():
    composition, order = Composition(), []
    publish_first, publish_second = (composition.advertise(Line(topic), False)
                                     for topic in ('/first', '/second'))

    def answer(message):
        composition.defer(lambda: order.append('deferred'))
        publish_second.publish('second')
        order.append('first')
    composition.subscribe(
        '/first', lambda message: order.append('in no hurry'), pytest.fail, last=True)
    composition.subscribe('/first', answer, pytest.fail)
    composition.subscribe('/second', order.append, pytest.fail)
    composition.connect()
    publish_first.publish('first')
    assert order == ['first', 'second', 'in no hurry', 'deferred']
    composition.defer(lambda: order.append('at once'))
    assert order[-1] == 'at once'


def test_only_what_no_node_gives_is_subscribed_to():
    composition, subscribed = Composition(), []
    composition.subscribe('/own', print, lambda: subscribed.append('/own'))
    composition.subscribe('/foreign', print, lambda: subscribed.append('/foreign'))
    composition.advertise(Line('/own'), False)
    assert not subscribed, 'a node that gives it may still come'
    composition.connect()
    composition.subscribe('/late', print, lambda: subscribed.append('/late'))
    composition.subscribe('/own', print, lambda: subscribed.append('/own'))
    assert subscribed == ['/foreign', '/late']


def test_an_error_does_not_leave_messages_behind():
    composition, taken = Composition(), []
    publisher = composition.advertise(Line('/topic'), False)

    def fail(message):
        raise RuntimeError(message)
    composition.subscribe('/topic', fail, pytest.fail)
    composition.subscribe('/topic', taken.append, pytest.fail)
    with pytest.raises(RuntimeError, match='first'):
        publisher.publish('first')
    with pytest.raises(RuntimeError, match='second'):
        publisher.publish('second')
    assert not taken


def right_attitudes(probe, count):
    """Wait for attitudes and hold them against the truth, which comes after them."""
    def of_both():
        truth, answers = ({ns_from_stamp(message.header.stamp): quaternion_from_message(message)
                           for message in probe.received[topic]}
                          for topic in ('truth/attitude', 'attitude'))
        return [(answers[stamp_ns], truth[stamp_ns]) for stamp_ns in answers if stamp_ns in truth]
    probe.wait(lambda: len(of_both()) >= count, f'{count} attitudes with their truth')
    for answer, truth in of_both():
        assert np.hypot(*attitude_error(answer, truth)[:2]) < 30 * ARCSEC


def test_a_composed_pipeline_finds_the_attitude(nodes, probe):
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    probe.collect(QuaternionStamped, 'attitude', qos.LIST)
    # The simulator and the stages, images never on DDS; names and services as ever.
    nodes.start('composed_pipeline', SKY, ['--', 'sky_simulator', *STAGES])
    right_attitudes(probe, 20)
    assert {'sky_simulator', *STAGES} <= set(probe.get_node_names())
    assert probe.count_publishers('image_raw') == 1
    assert probe.count_subscribers('image_raw') == 0
    assert probe.call(Trigger, 'star_tracker/reset', Trigger.Request()).success
    before = len(probe.received['attitude'])
    right_attitudes(probe, before + 10)
    probe.wait(lambda: {'centroid_extractor: centroids', 'star_tracker: tracking'} <= {
        status.name for status in probe.statuses()}, 'the diagnostics of both')


def test_the_four_stages_take_a_camera_of_another_process(nodes, probe):
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    probe.collect(QuaternionStamped, 'attitude', qos.LIST)
    nodes.start('composed_pipeline')
    nodes.start('sky_simulator', {name.partition(':')[2]: value for name, value in SKY.items()})
    right_attitudes(probe, 10)
    assert probe.count_subscribers('image_raw') == 1
    assert probe.count_subscribers('centroids') == 0


def test_a_frame_is_one_call_while_nobody_wants_the_stages_apart(nodes, probe):
    for topic in ('truth/attitude', 'attitude'):
        probe.collect(QuaternionStamped, topic, qos.LIST)
    nodes.start('composed_pipeline')
    nodes.start('sky_simulator', {name.partition(':')[2]: value for name, value in SKY.items()})

    def wait_for_calls(count):
        probe.wait(lambda: probe.diagnostic_value(
            'attitude_estimator: attitude', 'calls_per_frame') == count, f'{count} calls a frame')
        right_attitudes(probe, len(probe.received['attitude']) + 10)
    wait_for_calls('1')
    # The width of the stars is for another extractor, which the path is built again for.
    width = Parameter('psf_sigma_px', value=0.8).to_parameter_msg()
    assert probe.call(SetParametersAtomically, 'centroid_extractor/set_parameters_atomically',
                      SetParametersAtomically.Request(parameters=[width])).result.successful
    assert probe.call(Trigger, 'attitude_estimator/reset', Trigger.Request()).success
    probe.forget()
    wait_for_calls('1')
    # The extractor needs what the tracker predicts of a target.
    probe.collect(PointCloud2, 'target_centroid', qos.LIST)
    wait_for_calls('3')


def test_remaps_and_parameters_of_one_node(nodes, probe):
    """A remapped topic stays within the process; one that no node publishes comes over DDS."""
    arguments = ['--ros-args', '-p', 'star_tracker:min_stars:=6', '-r', 'star_tracker:imu:=gyro',
                 '-r', 'tracks:=my_tracks']
    nodes.start('composed_pipeline', extra=['--', *STAGES[2:], *arguments])
    values = [probe.call(GetParameters, f'/{node}/get_parameters', GetParameters.Request(
        names=['min_stars'])).values[0].integer_value for node in STAGES[2:]]
    assert values == [6, 4]
    probe.wait(lambda: probe.count_subscribers('gyro'), 'the gyro')
    assert probe.count_subscribers('imu') == 0
    assert probe.count_publishers('my_tracks') == 1
    assert not probe.count_subscribers('my_tracks') + probe.count_subscribers('tracks')


@pytest.mark.parametrize(('arguments', 'words'), [
    (['star_traker'], "no node 'star_traker'"),
    (['star_tracker', 'star_identifier', '--ros-args', '-p',
      'star_tracker:magnitude_limitt:=6.0'],
     'unknown parameter magnitude_limitt; did you mean magnitude_limit?'),
    (['star_tracker', 'sky_simulator', '--ros-args', '-p', 'star_tracker:fov_deg:=6.0'],
     'unknown parameter fov_deg'),
])
def test_what_cannot_be_composed_is_refused(arguments, words):
    done = subprocess.run(node_command('composed_pipeline', arguments), timeout=HANGS_S,
                          env=node_environment(), capture_output=True, text=True)
    assert done.returncode != 0
    assert words in done.stderr + done.stdout
