"""Managed nodes: transitions over their services, alone and in a running pipeline."""

from pathlib import Path
import random

from geometry_msgs.msg import QuaternionStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
import numpy as np
import pytest
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.executables import STAGES
from startracker_ros.maths.rotation import ARCSEC, attitude_error
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message

SKY = {'width': 256, 'height': 256, 'fov_deg': 20.0, 'frame_rate_hz': 5.0,
       'motion': 'constant_rate', 'rate_deg_s': [0.05, 0.1, 0.02], 'faint_limit': 6.5}
# The largest error that was measured is 30, about the boresight: a pixel is 281.
WRONG_ARCSEC = 120.0
UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE)
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE)
# The primary states and transitions of the ROS 2 lifecycle, without shutdown.
NEXT = {(UNCONFIGURED, CONFIGURE): INACTIVE, (INACTIVE, ACTIVATE): ACTIVE,
        (ACTIVE, DEACTIVATE): INACTIVE, (INACTIVE, CLEANUP): UNCONFIGURED}
SEQUENCES = 15
GOLDEN_BAG = Path(__file__).parents[2] / 'bags' / 'slew'


class Manager:
    """Changes the states of nodes, as a lifecycle manager does."""

    def __init__(self, probe, folder):
        self._probe, self._folder = probe, folder
        self._clients = {}

    def change(self, node, transition):
        """Return whether a transition succeeded; it is requested once only."""
        if node not in self._clients:
            self._clients[node] = self._connected(node)
        request = ChangeState.Request()
        request.transition.id = transition
        future = self._clients[node].call_async(request)
        self._probe.wait(future.done, f'the response of {node}')
        return future.result().success

    def _connected(self, node):
        client = self._probe.create_client(ChangeState, f'/{node}/change_state')
        self._probe.wait(client.service_is_ready, f'the services of {node}')
        # A transition that no state has, until the service has discovered the client.
        futures = []
        for _ in range(40):
            futures.append(client.call_async(ChangeState.Request()))
            if self._probe.spin_until(lambda: any(one.done() for one in futures), 3.0):
                break
        done = [future.result() for future in futures if future.done()]
        assert done and not done[0].success
        return client

    def state(self, node):
        return self._probe.call(
            GetState, f'/{node}/get_state', GetState.Request()).current_state.id

    def log(self, node):
        return (self._folder / f'{node}.log').read_text()


class Pipeline(Manager):
    """A simulator and the four stages, with every attitude compared with the truth."""

    def __init__(self, nodes, probe, folder, composed):
        super().__init__(probe, folder)
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

    def check_attitudes(self):
        truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
                 for message in self.received('truth/attitude')}
        errors = [attitude_error(quaternion_from_message(message), truth[stamp])
                  for message in self.received('attitude')
                  if (stamp := ns_from_stamp(message.header.stamp)) in truth]
        assert len(errors) > 10
        assert np.abs(errors).max() / ARCSEC < WRONG_ARCSEC
        assert self.nodes.ended() == []


@pytest.mark.parametrize('composed', [False, True], ids=['processes', 'composed'])
def test_an_inactive_node_is_silent_and_continues_when_it_is_active(
        nodes, probe, tmp_path, composed):
    pipeline = Pipeline(nodes, probe, tmp_path, composed)
    for node, topic in (('attitude_estimator', 'attitude_imu'), ('star_tracker', 'tracks')):
        assert pipeline.state(node) == ACTIVE
        assert not pipeline.change(node, ACTIVATE) and pipeline.state(node) == ACTIVE
        assert pipeline.change(node, DEACTIVATE) and pipeline.state(node) == INACTIVE
        probe.spin_for(0.3)
        silent = len(pipeline.received(topic))
        pipeline.frames(8)
        assert len(pipeline.received(topic)) == silent
        probe.wait(lambda node=node: probe.find_diagnostic('inactive', node=node), 'inactive')
        assert pipeline.change(node, ACTIVATE)
        pipeline.wait_for_attitudes(5)
        assert pipeline.change(node, DEACTIVATE) and pipeline.change(node, CLEANUP)
        assert pipeline.state(node) == UNCONFIGURED
        silent = len(pipeline.received(topic))
        pipeline.frames(3)
        assert len(pipeline.received(topic)) == silent
        assert pipeline.change(node, CONFIGURE) and pipeline.change(node, ACTIVATE)
        pipeline.wait_for_attitudes(5)
    # The sky stands still, and continues from there.
    assert pipeline.change('sky_simulator', DEACTIVATE)
    probe.spin_for(0.3)
    count = len(pipeline.received('truth/attitude'))
    probe.spin_for(1.0)
    assert len(pipeline.received('truth/attitude')) == count
    assert pipeline.change('sky_simulator', ACTIVATE)
    pipeline.frames(2)
    last, following = pipeline.received('truth/attitude')[count - 1:count + 1]
    step = np.linalg.norm(attitude_error(
        quaternion_from_message(following), quaternion_from_message(last)))
    expected = np.radians(np.linalg.norm(SKY['rate_deg_s'])) / SKY['frame_rate_hz']
    assert np.isclose(step, expected, rtol=1e-3)
    pipeline.wait_for_attitudes(5)
    pipeline.check_attitudes()


def test_random_transitions_end_with_attitudes_that_are_right(nodes, probe, tmp_path):
    pipeline = Pipeline(nodes, probe, tmp_path, composed=False)
    rng = random.Random(7)
    everything = (*STAGES, 'sky_simulator')
    states = dict.fromkeys(everything, ACTIVE)
    for _ in range(SEQUENCES):
        for _ in range(4):
            node, transition = rng.choice(everything), rng.choice(
                (CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE))
            following = NEXT.get((states[node], transition))
            assert pipeline.change(node, transition) == (following is not None), node
            states[node] = following or states[node]
            assert pipeline.state(node) == states[node]
            probe.spin_for(rng.choice((0.0, 0.5)))
        for node in everything:
            while states[node] != ACTIVE:
                transition = CONFIGURE if states[node] == UNCONFIGURED else ACTIVATE
                assert pipeline.change(node, transition)
                states[node] = NEXT[states[node], transition]
        pipeline.wait_for_attitudes(3)
    pipeline.check_attitudes()


def test_a_player_pauses_while_it_is_inactive_and_begins_anew_after_cleanup(
        nodes, probe, tmp_path):
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    received = probe.received['truth/attitude']
    nodes.start('bag_player', {'path': str(GOLDEN_BAG), 'topics': ['/truth/attitude'],
                               'rate': 0.2})
    manager = Manager(probe, tmp_path)
    probe.wait(lambda: len(received) >= 3, 'messages')
    assert manager.change('bag_player', DEACTIVATE)
    probe.spin_for(0.3)
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
    manager = Manager(probe, tmp_path)
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    for node in ('sky_simulator', 'image_publisher'):
        assert manager.state(node) == UNCONFIGURED
    assert not manager.change('image_publisher', CONFIGURE)
    assert manager.state('image_publisher') == UNCONFIGURED
    assert 'path is empty' in manager.log('image_publisher')
    probe.wait_diagnostic('unconfigured')
    assert manager.change('sky_simulator', CONFIGURE)
    probe.spin_for(1.0)
    assert not probe.received['truth/attitude']
    assert manager.change('sky_simulator', ACTIVATE)
    probe.wait(lambda: probe.received['truth/attitude'], 'a frame')
    assert manager.change('sky_simulator', Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert manager.state('sky_simulator') == State.PRIMARY_STATE_FINALIZED
    probe.wait_diagnostic('finalized')
