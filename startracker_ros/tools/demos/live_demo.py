# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A demo: node processes on a simulated sky, shown live, recorded and summarised."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
import math
import os
from pathlib import Path
import shutil
import sys
import time
from typing import Any

import psutil
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.live import Live
from rich.table import Table
from sensor_msgs.msg import CameraInfo, Imu
from startracker_ros.core.extras import MissingLibraryError
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import BagMessage, read_messages
from startracker_ros.ros import qos
from startracker_ros.ros.probe import Progress
from startracker_ros.ros.processes import claim_domain, HarnessError, set_environment, take_domain
from startracker_ros.ros.rig import Rig
from startracker_ros.tools.demos.readiness import Needs, Readiness
from startracker_ros.tools.figures.machine import MachineLoad


STALL_S = 300.0
"""Time without any change after which a demo gives up: a busy machine takes minutes to start."""
_REPORT_S = 10.0
_FLUSHES = 2
_FURTHER_S, _DISCOVERY_S = 0.25, 0.5
"""Nodes of an idle machine are found within 0.25 s, those of a busy one within a second."""


def _check(progress: Progress, value: object, what: str) -> None:
    """HarnessError with what does not happen, once a value has not changed for STALL_S."""
    if progress.is_stalled(value):
        raise HarnessError(f'{what}: nothing has changed for {STALL_S:g} s')


class Demo(Rig, ABC):
    """
    Node processes with a live table, in the ROS domain of the user unless that is in use.

    endpoints holds the publishers and subscribers, those of the demo and of the recorder
    included, that each topic has once all nodes are connected. needs are all nodes. The
    simulators wait for a subscriber of each topic in camera_infos, which the demo is once all
    nodes are ready: no frame is lost, however slow the machine is.
    """

    endpoints: Mapping[str, tuple[int, int]]
    needs: Needs
    camera_infos: Sequence[str] = ('camera_info',)

    def __init__(self, output: Path) -> None:
        self.bag = output / 'bag'
        self.load = MachineLoad()
        self._begin_s = time.monotonic()
        logs = _prepare(output)
        _choose_domain([topic for topic, (publishers, _) in self.endpoints.items() if publishers])
        super().__init__(logs, isolated=False, name='demo_monitor')
        self.probe.collect_diagnostics()
        self._sent_ns = dict.fromkeys(self.camera_infos, 0)
        self._answered_ns = dict.fromkeys(self.camera_infos, 0)

    @property
    @abstractmethod
    def frames(self) -> int:
        """Frames that were simulated."""

    @abstractmethod
    def table(self, frames: int) -> Table:
        """Return the table that is shown; frames is the number of all frames."""

    def simulated_frames(self, hardware_id: str = '') -> int:
        """Return the number of frames that a sky_simulator reports."""
        return int(self.probe.diagnostic_value(
            'sky_simulator: simulation', 'frames', hardware_id) or 0)

    def await_ready(self, prompt: Callable[[], None] = lambda: None) -> None:
        """
        Wait until all nodes are ready, print their conditions, then let the simulation start.

        prompt() is called again and again. HarnessError when a node ends or nothing changes.
        """
        readiness, shown = Readiness(self.probe, self.needs), dict[str, str]()
        progress = Progress(STALL_S)
        report_s = time.monotonic() + _REPORT_S
        while True:
            prompt()
            self.probe.spin_once(0.1)
            readiness.update()
            missing = self._missing_endpoints()
            if not missing:
                readiness.connected()
            conditions = readiness.conditions()
            for name, text in conditions.items():
                if shown.get(name) != text:
                    self._print(f'{name[1:]}: {text or "ready"}')
            if conditions != shown:
                report_s = time.monotonic() + _REPORT_S
            shown = conditions
            waiting = [name[1:] for name, text in conditions.items() if text]
            if not waiting:
                break
            if time.monotonic() > report_s:
                report_s = time.monotonic() + _REPORT_S
                self._print(f'waiting for {", ".join(waiting)}; {len(missing)} of '
                            f'{len(self.endpoints)} topics not connected')
            self._check_nodes()
            _check(progress, (readiness.activity(), missing),
                   f'not ready: {", ".join(waiting)}; topics not connected: '
                   f'{", ".join(missing) or "none"}; see {self.log_folder}')
        self._print('all nodes are ready: the first frame')
        self._release()

    def watch(self, frames: int) -> None:
        """Show the table until all frames have their attitudes; HarnessError if a node fails."""
        self.await_ready()
        progress = Progress(STALL_S)
        with self._live(frames) as live:
            while self.frames < frames or self._in_flight():
                self.probe.spin_once(0.1)
                live.update(self.table(frames))
                self._check_nodes()
                _check(
                    progress, (self.frames, {**self._answered_ns}),
                    f'no attitude_imu after frame {self.frames} of {frames}; see '
                    f'{self.log_folder}')
        live.console.print()
        self.await_recorder()

    def _live(self, frames: int) -> Live:
        """Return the display of the table; on stderr, as stdout may be for a document."""
        return Live(self.table(frames), console=Console(stderr=True), refresh_per_second=4)

    def await_recorder(self) -> None:
        """Wait until the recorder has had time for what was sent to it."""
        def received() -> int:
            return sum(diagnostic.node == 'bag_recorder' for diagnostic in self.probe.diagnostics)
        enough = received() + _FLUSHES
        self.probe.wait(lambda: received() >= enough, 'the recorder', STALL_S)

    def _print(self, text: str) -> None:
        print(f'[{time.monotonic() - self._begin_s:5.1f} s] {text}', file=sys.stderr, flush=True)

    def _check_nodes(self) -> None:
        """HarnessError when a node has ended, or another star tracker publishes."""
        if ended := self.processes.ended():
            raise HarnessError(f'{", ".join(ended)} ended early: see {self.log_folder}')
        for topic, (publishers, _) in self.endpoints.items():
            if self.probe.count_publishers(topic) > publishers:
                names = _publishing_nodes(self.probe, topic)
                raise HarnessError(
                    f'{len(names)} nodes publish {topic} in ROS domain '
                    f'{self._context.get_domain_id()}, where the demo has {publishers}: '
                    f'{", ".join(names)}. End the others or set another ROS_DOMAIN_ID')

    def _missing_endpoints(self) -> list[str]:
        """Return the topics that do not have all their publishers and subscribers yet."""
        return [topic for topic, (publishers, subscribers) in self.endpoints.items()
                if self.probe.count_publishers(topic) < publishers
                or self.probe.count_subscribers(topic) < subscribers]

    def _in_flight(self) -> bool:
        """Return whether the newest frame of a camera has no attitude_imu yet."""
        return any(self._answered_ns[topic] < sent_ns for topic, sent_ns in self._sent_ns.items())

    def _release(self) -> None:
        """Let the simulators start: follow camera_info, of which a frame has one, and answers."""
        def follow(newest_ns: dict[str, int], topic: str, message: CameraInfo | Imu) -> None:
            newest_ns[topic] = max(newest_ns[topic], ns_from_stamp(message.header.stamp))
        for topic in self.camera_infos:
            self.probe.create_subscription(
                Imu, topic.replace('camera_info', 'attitude_imu'),
                partial(follow, self._answered_ns, topic), qos.LIST)
            self.probe.create_subscription(
                CameraInfo, topic, partial(follow, self._sent_ns, topic), qos.LIST)

    def finish(self) -> None:
        """End all nodes; HarnessError when one does not end cleanly."""
        bad = [f'{name} (status {code})'
               for name, code in self.stop().items() if code != 0]
        if bad:
            raise HarnessError(f'{", ".join(bad)} did not end cleanly: see {self.log_folder}')

    def bag_text(self) -> str:
        """Return the path of the bag and its size."""
        size_mb = sum(file.stat().st_size for file in self.bag.iterdir()) / 1e6
        return f'{self.bag} ({size_mb:.0f} MB)'


class LockStepDemo(Demo):
    """
    A demo that steps frame by frame: each step publishes a frame and awaits its attitudes.

    cpu_s is the processor time of all processes in s, starts included, after the last step.
    """

    def __init__(self, output: Path) -> None:
        super().__init__(output)
        self.cpu_s = math.nan

    def run_steps(self, step: Callable[[], None], is_finished: Callable[[], bool], frames: int
                  ) -> float:
        """Step and show the table until the end; return the wall time in s."""
        begin_s = time.monotonic()
        with self._live(frames) as live:
            while not is_finished():
                step()
                live.update(self.table(frames))
        wall_s = time.monotonic() - begin_s
        self.cpu_s = sum(sum(process.cpu_times()[:2]) for process in [
            psutil.Process(),
            *(psutil.Process(process.pid) for process in self.processes.processes.values())])
        self.await_recorder()
        return wall_s

    def await_attitudes(self, missing: Callable[[], str]) -> None:
        """Wait until no attitude_imu is missing; HarnessError with what missing() returns."""
        progress = Progress(STALL_S)
        while text := missing():
            self.probe.spin_once(0.1)
            self._check_nodes()
            _check(progress, text, f'no attitude_imu of {text}; see {self.log_folder}')


def draw_if_possible(picture: Path, draw: Callable[[], None]) -> str:
    """Return the path of the picture, or which library drawing it needs."""
    try:
        draw()
    except MissingLibraryError as error:
        return str(error)
    return str(picture)


def start_time_s() -> float:
    """Return when this process began, UNIX time in s."""
    return psutil.Process().create_time()


def _choose_domain(topics: Sequence[str]) -> None:
    """
    Take another ROS domain where one of the topics is published in that of the user, and say so.

    HarnessError where the user has chosen the domain by ROS_DOMAIN_ID.
    """
    set_environment(isolated=False)
    given = os.environ.get('ROS_DOMAIN_ID')
    # What another demo is only starting is not found yet, hence its claim.
    if given or claim_domain(0):
        users = _other_nodes(topics)
        if not users:
            return
        if given:
            raise HarnessError(f'{", ".join(users)} publish in ROS domain {given} what the demo '
                               'publishes: end them or set another ROS_DOMAIN_ID')
    os.environ['ROS_DOMAIN_ID'] = take_domain()
    print('a star tracker runs in ROS domain 0, hence the demo takes another one: '
          f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}', file=sys.stderr)


def _other_nodes(topics: Sequence[str]) -> list[str]:
    """Return the nodes that publish one of the topics."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node('demo_looks_around', context=context, enable_rosout=False,
                    start_parameter_services=False)
        deadline_s = time.monotonic() + _DISCOVERY_S
        while not any(map(node.count_publishers, topics)) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        if any(map(node.count_publishers, topics)):
            # The other nodes of a star tracker are found soon after the first one.
            time.sleep(_FURTHER_S)
        return sorted({name for topic in topics for name in _publishing_nodes(node, topic)})
    finally:
        rclpy.shutdown(context=context)


def _publishing_nodes(node: Node, topic: str) -> list[str]:
    return [f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for info in node.get_publishers_info_by_topic(topic)]


def _prepare(output: Path) -> Path:
    """Clear the output folder and return a folder for logs in it."""
    logs = output / 'logs'
    try:
        _clear(output)
        logs.mkdir(parents=True)
    except OSError as error:
        raise HarnessError(f'output folder {output}: {error.strerror}') from error
    return logs


def _clear(output: Path) -> None:
    """Remove bag and logs of an earlier demo, and nothing else."""
    bag = output / 'bag'
    if bag.exists():
        if not list(bag.glob('*.mcap')):
            raise HarnessError(f'{bag} exists and holds no bag: choose another --output')
        shutil.rmtree(bag)
    shutil.rmtree(output / 'logs', ignore_errors=True)


def read_stamped(bag: Path, topics: Sequence[str], start_ns: int = 0
                 ) -> Iterator[tuple[BagMessage, int, Any]]:
    """Yield the messages of topics in a bag: as recorded, stamp in ns, decoded."""
    for record in read_messages(bag, topics=topics, start_ns=start_ns):
        message = record.decoded()
        yield record, ns_from_stamp(message.header.stamp), message
