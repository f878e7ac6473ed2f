# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Managed nodes: transitions over their services, alone and in a running pipeline."""

from pathlib import Path

from geometry_msgs.msg import QuaternionStamped
from lifecycle_msgs.msg import State, Transition
from limits import HANGS_S
import numpy as np
import pytest
from sensor_msgs.msg import Imu, PointCloud2
from startracker_evaluation.campaign.lifecycle import rows_of
from startracker_evaluation.harness.random_transitions import (
    ACTIVATE, ACTIVE, CLEANUP, CONFIGURE, DEACTIVATE, INACTIVE, NodeManager, RandomTransitions,
    UNCONFIGURED)
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.maths.rotation import attitude_error, matrix_from_quaternion
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import quaternion_from_message

SKY = {'width': 256, 'height': 256, 'fov_deg': 20.0, 'frame_rate_hz': 5.0,
       'motion': 'constant_rate', 'rate_deg_s': [0.05, 0.1, 0.02], 'faint_limit': 6.5}
SEQUENCES = 4
GOLDEN_BAG = Path(__file__).parents[2] / 'bags' / 'slew'


class Pipeline(NodeManager):
    """A simulator and the four stages, with every attitude compared with the truth."""

    def __init__(self, nodes, probe, composed):
        super().__init__(probe)
        self.nodes = nodes
        for topic in ('attitude', 'truth/attitude'):
            probe.collect(QuaternionStamped, topic, qos.LIST)
        probe.collect(Imu, 'attitude_imu', qos.LIST)
        probe.collect(PointCloud2, 'tracks', qos.LIST)
        for node in (('composed_pipeline',) if composed else STAGES):
            nodes.start(node)
        nodes.start('sky_simulator', {**SKY, 'wait_for_camera_users': len(STAGES)})
        self.wait_for_attitudes(5)

    def received(self, topic):
        return self._probe.received[topic]

    def wait_for_attitudes(self, count):
        end = len(self.received('attitude')) + count
        self._probe.wait(lambda: len(self.received('attitude')) >= end, f'{count} attitudes')

    def frames(self, count):
        """Process messages for a number of frames of the simulator."""
        end = len(self.received('truth/attitude')) + count
        self._probe.wait(lambda: len(self.received('truth/attitude')) >= end, f'{count} frames')

    def newest_ns(self):
        """Return the stamp of the newest frame of the simulator."""
        return ns_from_stamp(self.received('truth/attitude')[-1].header.stamp)

    def check_silent(self, topic, frames):
        """Nothing is published for the frames that follow those of now."""
        newest_ns = self.newest_ns()
        self.frames(frames)
        assert all(ns_from_stamp(message.header.stamp) <= newest_ns
                   for message in self.received(topic))

    def check_attitudes(self):
        truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
                 for message in self.received('truth/attitude')}
        attitudes = 0
        for message in self.received('attitude_imu'):
            stamp_ns = ns_from_stamp(message.header.stamp)
            if stamp_ns not in truth or message.orientation_covariance[0] < 0:
                continue
            q = message.orientation
            estimate = np.array([q.x, q.y, q.z, q.w])
            error = matrix_from_quaternion(estimate) @ attitude_error(estimate, truth[stamp_ns])
            sigma = np.sqrt(message.orientation_covariance[::4])
            assert np.all(np.abs(error) < WRONG_SIGMAS * sigma)
            attitudes += 1
        assert attitudes > 10
        assert self.nodes.ended() == []


@pytest.mark.parametrize('composed', [False, pytest.param(True, marks=pytest.mark.long)],
                         ids=['processes', 'composed'])
def test_an_inactive_node_is_silent_and_continues_when_it_is_active(nodes, probe, composed):
    pipeline = Pipeline(nodes, probe, composed)
    for node, topic in (('attitude_estimator', 'attitude_imu'), ('star_tracker', 'tracks')):
        assert pipeline.state(node) == ACTIVE
        assert not pipeline.change(node, ACTIVATE) and pipeline.state(node) == ACTIVE
        assert pipeline.change(node, DEACTIVATE) and pipeline.state(node) == INACTIVE
        # The next frame may have been published before, and not have come yet.
        pipeline.frames(1)
        pipeline.check_silent(topic, 8)
        probe.wait(lambda node=node: probe.find_diagnostic('inactive', node=node), 'inactive')
        assert pipeline.change(node, ACTIVATE)
        pipeline.wait_for_attitudes(5)
        assert pipeline.change(node, DEACTIVATE) and pipeline.change(node, CLEANUP)
        assert pipeline.state(node) == UNCONFIGURED
        pipeline.check_silent(topic, 3)
        assert pipeline.change(node, CONFIGURE) and pipeline.change(node, ACTIVATE)
        pipeline.wait_for_attitudes(5)
    # The sky stands still, and continues from there.
    assert pipeline.change('sky_simulator', DEACTIVATE)
    assert pipeline.state('sky_simulator') == INACTIVE
    probe.spin_for(1.3)
    assert pipeline.change('sky_simulator', ACTIVATE)
    newest_ns = pipeline.newest_ns()
    probe.wait(lambda: pipeline.newest_ns() > newest_ns + 1_300_000_000, 'a frame after that')
    truth = pipeline.received('truth/attitude')
    gap = np.argmax(np.diff([ns_from_stamp(message.header.stamp) for message in truth]))
    last, following = truth[gap:gap + 2]
    assert ns_from_stamp(following.header.stamp) - ns_from_stamp(last.header.stamp) > 1.3e9
    step = np.linalg.norm(attitude_error(
        quaternion_from_message(following), quaternion_from_message(last)))
    expected = np.radians(np.linalg.norm(SKY['rate_deg_s'])) / SKY['frame_rate_hz']
    assert np.isclose(step, expected, rtol=1e-3)
    pipeline.wait_for_attitudes(5)
    pipeline.check_attitudes()


def test_random_transitions_end_with_attitudes_that_are_right(tmp_path):
    with RandomTransitions(tmp_path, composed=False, seed=7, timeout_s=HANGS_S) as transitions:
        result = transitions.run(SEQUENCES)
        codes = transitions.stop(HANGS_S)
    assert (result.sequences, result.wrong_responses, result.ended) == (SEQUENCES, 0, [])
    assert result.requests >= 4 * SEQUENCES
    assert result.attitudes >= 3 * SEQUENCES
    assert (result.wrong, result.unverified) == (0, 0)
    assert codes.keys() == result.samples.keys() == {*STAGES, 'sky_simulator'}
    assert set(codes.values()) == {0}
    rows = {row.case: row for row in rows_of('processes', result)}
    assert rows['processes: wrong attitudes'].holds
    assert all(f'processes: {node}: growth in 1000 sequences' in rows for node in codes)


def test_a_player_pauses_while_it_is_inactive_and_begins_anew_after_cleanup(nodes, probe):
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    received = probe.received['truth/attitude']
    nodes.start('bag_player', {'path': str(GOLDEN_BAG), 'topics': ['/truth/attitude'],
                               'rate': 0.2, 'wait_limit_s': HANGS_S})
    manager = NodeManager(probe)
    probe.wait(lambda: len(received) >= 3, 'messages')
    assert manager.change('bag_player', DEACTIVATE)
    assert manager.state('bag_player') == INACTIVE
    # What was published before has come before the next status but one.
    probe.diagnostics.clear()
    probe.wait(lambda: sum('inactive' in one.status.message for one in probe.diagnostics
                           if one.node == 'bag_player') >= 2, 'inactive')
    count = len(received)
    probe.spin_for(1.5)
    assert len(received) == count
    assert manager.change('bag_player', ACTIVATE)
    probe.wait(lambda: len(received) > count, 'the next message')
    stamps = [ns_from_stamp(message.header.stamp) for message in received]
    assert np.ptp(np.diff(stamps)) < 1e6
    assert manager.change('bag_player', DEACTIVATE) and manager.change('bag_player', CLEANUP)
    assert nodes.ended() == []
    count = len(received)
    assert manager.change('bag_player', CONFIGURE)
    assert manager.change('bag_player', ACTIVATE)
    probe.wait(lambda: len(received) > count, 'the first message again')
    assert received[count].header == received[0].header


def test_without_autostart_a_node_does_nothing_until_it_is_configured(nodes, probe, tmp_path):
    nodes.start('sky_simulator', {**SKY, 'autostart': False})
    nodes.start('image_publisher', {'autostart': False})
    manager = NodeManager(probe)
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    for node in ('sky_simulator', 'image_publisher'):
        assert manager.state(node) == UNCONFIGURED
    assert not manager.change('image_publisher', CONFIGURE)
    assert manager.state('image_publisher') == UNCONFIGURED
    assert 'path is empty' in (tmp_path / 'image_publisher.log').read_text()
    probe.wait_diagnostic('unconfigured')
    assert manager.change('sky_simulator', CONFIGURE)
    probe.spin_for(1.0)
    assert not probe.received['truth/attitude']
    assert manager.change('sky_simulator', ACTIVATE)
    probe.wait(lambda: probe.received['truth/attitude'], 'a frame')
    assert manager.change('sky_simulator', Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert manager.state('sky_simulator') == State.PRIMARY_STATE_FINALIZED
    probe.wait_diagnostic('finalized')
