# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Random transitions of the nodes of a running pipeline, whose attitudes are verified."""

from dataclasses import dataclass, field
from pathlib import Path
import random
import time

from geometry_msgs.msg import QuaternionStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
import numpy as np
from rclpy.client import Client
from rich.progress import Progress
from sensor_msgs.msg import CameraInfo, Imu
from startracker_evaluation.harness.process_sample import ProcessSample, sample_process
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)
from startracker_ros.ros.probe import Probe
from startracker_ros.ros.rig import Rig
from startracker_ros.tools.figures.correctness import verdict, WrongCount

SIMULATOR = 'sky_simulator'
SKY = {'width': 256, 'height': 256, 'fov_deg': 12.0, 'frame_rate_hz': 10.0,
       'motion': 'constant_rate', 'rate_deg_s': [0.05, 0.1, 0.02]}
TRANSITIONS = 4
"""Random transitions in a sequence."""
LONGEST_PAUSE_S = 0.5
"""Between two transitions; half of them follow at once."""
DEACTIVATED, CLEANED_UP, ANOTHER_SKY = 'deactivated', 'cleaned up', 'another sky'
_ATTITUDES = 3
"""Attitudes after a sequence, before the next one."""
_START_TIMEOUT_S = 600.0
# On a busy machine this process may read nothing for seconds.
_DEEP = 1000

UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE)
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE)
NEXT_STATE = {
    (UNCONFIGURED, CONFIGURE): INACTIVE, (INACTIVE, ACTIVATE): ACTIVE,
    (ACTIVE, DEACTIVATE): INACTIVE, (INACTIVE, CLEANUP): UNCONFIGURED}
"""The primary states and transitions of the ROS 2 lifecycle, without shutdown."""

_CONNECT_ATTEMPTS = 40
_CONNECT_RESPONSE_S = 3.0


@dataclass
class TransitionsResult:
    """
    Counts of a run, and per sequence the resources of each process.

    wrong_responses: requests whose response or next state differs from the lifecycle's.
    reactivation_s: from the request of the last activation of a sequence to the next attitude, by
    what the sequence had done before. ended: names of the processes that have ended. unverified:
    attitudes whose truth was not received.
    """

    sequences: int = 0
    requests: int = 0
    wrong_responses: int = 0
    attitudes: int = 0
    wrong: int = 0
    gross: int = 0
    unverified: int = 0
    ended: list[str] = field(default_factory=list)
    reactivation_s: dict[str, list[float]] = field(default_factory=lambda: {
        DEACTIVATED: [], CLEANED_UP: [], ANOTHER_SKY: []})
    samples: dict[str, list[ProcessSample]] = field(default_factory=dict)


class RandomTransitions(Rig):
    """
    A simulator and the four stages, as processes or composed.

    After each sequence of random transitions, possible and impossible ones, all nodes are brought
    up as pipeline_manager does, and the next attitudes are awaited and compared with the truth.
    """

    def __init__(self, log_folder: Path, *, composed: bool, seed: int, timeout_s: float = 300.0
                 ) -> None:
        super().__init__(log_folder, timeout_s=timeout_s)
        self.manager = NodeManager(self.probe)
        self.result = TransitionsResult()
        self._rng = random.Random(seed)
        self._truth: dict[int, np.ndarray] = {}
        self._unverified: list[Imu] = []
        self._later: list[Imu] = []
        self._first_s = np.inf
        self.probe.create_subscription(Imu, 'attitude_imu', self._on_attitude_imu, _DEEP)
        self.probe.create_subscription(
            QuaternionStamped, 'truth/attitude', self._on_truth, _DEEP)
        # Last, and counted by the simulator: it begins when it has found the users of the truth.
        self.probe.create_subscription(CameraInfo, 'camera_info', lambda _: None, _DEEP)
        for name in (('composed_pipeline',) if composed else STAGES):
            self.processes.start(name)
        self.processes.start(SIMULATOR, {
            **SKY, 'seed': seed, 'wait_for_camera_users': len(STAGES) + 1})
        # Users of what a node publishes before the node, as pipeline_manager has them.
        self._states = dict.fromkeys((*STAGES[::-1], SIMULATOR), ACTIVE)

    def run(self, sequences: int) -> TransitionsResult:
        """Run sequences, up to the first end of a process; HarnessError without attitudes."""
        result = self.result
        self.wait_for_attitudes(_START_TIMEOUT_S)
        with Progress(transient=True) as progress:
            task = progress.add_task('lifecycle', total=sequences)
            while result.sequences < sequences and not result.ended:
                self._run_sequence()
                result.ended = self.processes.ended()
                if not result.ended:
                    self._sample()
                result.sequences += 1
                progress.update(task, completed=result.sequences)
        # Of the last attitudes the truth may still be on its way.
        self._verify()
        self._verify()
        return result

    def wait_for_attitudes(self, timeout_s: float | None = None) -> None:
        """Wait for some attitudes, or for the end of a process."""
        end = self._count + _ATTITUDES
        self.probe.wait(lambda: self._count >= end or self.processes.ended(),
                        f'{_ATTITUDES} attitudes after sequence {self.result.sequences}',
                        timeout_s)

    @property
    def _count(self) -> int:
        return self.result.attitudes + len(self._unverified) + len(self._later)

    def _run_sequence(self) -> None:
        cleaned_up = set()
        for _ in range(TRANSITIONS):
            node = self._rng.choice(tuple(self._states))
            transition = self._rng.choice((CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE))
            if self._request(node, transition) and transition == CLEANUP:
                cleaned_up.add(node)
            self.probe.spin_for(self._rng.choice((0.0, self._rng.uniform(0.0, LONGEST_PAUSE_S))))
        activated_s = self._bring_up()
        self.wait_for_attitudes()
        if activated_s is not None:
            self.result.reactivation_s[
                ANOTHER_SKY if SIMULATOR in cleaned_up else
                CLEANED_UP if cleaned_up else DEACTIVATED].append(self._first_s - activated_s)
        self._verify()

    def _bring_up(self) -> float | None:
        """Activate all nodes; return when the last was requested to, None if all were active."""
        for node in [node for node, state in self._states.items() if state == UNCONFIGURED]:
            self._request(node, CONFIGURE)
        activated_s = None
        for node in [node for node, state in self._states.items() if state != ACTIVE]:
            activated_s = time.monotonic()
            self._first_s = np.inf
            self._request(node, ACTIVATE)
        return activated_s

    def _request(self, node: str, transition: int) -> bool:
        """Request a transition; return whether the lifecycle has it."""
        expected = NEXT_STATE.get((self._states[node], transition))
        success, state = self.manager.change(node, transition), self.manager.state(node)
        self.result.requests += 1
        self.result.wrong_responses += (
            success != (expected is not None) or state != (expected or self._states[node]))
        self._states[node] = state
        return expected is not None

    def _on_truth(self, message: QuaternionStamped) -> None:
        self._truth[ns_from_stamp(message.header.stamp)] = quaternion_from_message(message)

    def _on_attitude_imu(self, message: Imu) -> None:
        if message.orientation_covariance[0] >= 0:
            self._first_s = min(self._first_s, time.monotonic())
            self._unverified.append(message)

    def _verify(self) -> None:
        """Compare attitudes with the truth, in a second attempt where it was not there yet."""
        attempts = ((self._later, True), (self._unverified, False))
        self._later, self._unverified = [], []
        for messages, last in attempts:
            for message in messages:
                truth = self._truth.get(ns_from_stamp(message.header.stamp))
                if truth is None and not last:
                    self._later.append(message)
                    continue
                self.result.attitudes += 1
                if truth is None:
                    self.result.unverified += 1
                    continue
                tracked = tracked_attitude_from_imu(message)
                found = WrongCount(1, 1) if tracked is None else verdict(
                    tracked.attitude.quaternion, tracked.attitude.covariance_sensor, truth)
                self.result.wrong += found.wrong
                self.result.gross += found.gross
        newest = sorted(self._truth)[-1000:]
        self._truth = {stamp_ns: self._truth[stamp_ns] for stamp_ns in newest}

    def _sample(self) -> None:
        for name in self.processes.processes:
            self.result.samples.setdefault(name, []).append(
                sample_process(self.processes.pid(name)))


class NodeManager:
    """Changes the states of managed nodes; HarnessError where one does not respond."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._clients: dict[str, Client] = {}

    def change(self, node: str, transition: int) -> bool:
        """Return whether a transition succeeded; it is requested once only."""
        if node not in self._clients:
            self._clients[node] = self._connected(node)
        request = ChangeState.Request()
        request.transition.id = transition
        future = self._clients[node].call_async(request)
        self._probe.wait(future.done, f'the response of {node}')
        return future.result().success

    def state(self, node: str) -> int:
        """Return the primary state of a node."""
        return self._probe.call(
            GetState, f'/{node}/get_state', GetState.Request()).current_state.id

    def _connected(self, node: str) -> Client:
        """
        Return a client that the service has discovered.

        Until then responses are lost, so a transition that no state has is requested repeatedly.
        """
        client = self._probe.create_client(ChangeState, f'/{node}/change_state')
        self._probe.wait(client.service_is_ready, f'the services of {node}')
        futures = []
        for _ in range(_CONNECT_ATTEMPTS):
            futures.append(client.call_async(ChangeState.Request()))
            if self._probe.spin_until(
                    lambda: any(one.done() for one in futures), _CONNECT_RESPONSE_S):
                break
        self._probe.wait(lambda: any(one.done() for one in futures), f'a response of {node}')
        return client
