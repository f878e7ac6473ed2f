"""A demo: node processes on a simulated sky, shown live, recorded and summarised."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
import math
from pathlib import Path
import shutil
import subprocess
import sys
import time
from typing import Any

import psutil
from rich.console import Console
from rich.live import Live
from rich.table import Table
from sensor_msgs.msg import CameraInfo
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.bag.reader import BagMessage, decode, read_messages
from startracker_ros.extras import MissingLibraryError
from startracker_ros.harness.probe import Progress
from startracker_ros.harness.processes import HarnessError, module_command, node_environment
from startracker_ros.harness.rig import Rig
from startracker_ros.machine_code import cached_share, machine_code_folder, package_code
from startracker_ros.ros import qos


class Demo(Rig, ABC):
    """
    Node processes with a live table, in the ROS domain of the user.

    endpoints holds the publishers and subscribers, those of the demo and of the recorder
    included, that each topic has once all nodes are connected. The simulators wait for a
    subscriber of each topic in camera_infos.
    """

    endpoints: Mapping[str, tuple[int, int]]
    camera_infos: Sequence[str] = ('camera_info',)

    def __init__(self, output: Path) -> None:
        self.bag = output / 'bag'
        super().__init__(_prepare(output), isolated=False, name='demo_monitor')
        self._connected = False
        self.probe.collect_diagnostics()

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

    def watch(self, frames: int, *, stall_s: float = 30.0) -> None:
        """Show the table until all frames are simulated; HarnessError when a node fails."""
        progress = Progress(stall_s)
        console = Console()
        with Live(self.table(frames), console=console, refresh_per_second=4) as live:
            while self.frames < frames:
                self.probe.spin_once(0.1)
                self._release_when_connected()
                live.update(self.table(frames))
                ended = self.processes.ended()
                if ended:
                    raise HarnessError(f'{", ".join(ended)} ended early: see {self.log_folder}')
                if progress.is_stalled(self.frames):
                    raise HarnessError(f'no frame after number {self.frames} of {frames} within '
                                       f'{stall_s:g} s: see {self.log_folder}')
        console.print()
        # Frames in flight.
        self.probe.spin_for(1.0)

    def _release_when_connected(self) -> None:
        """Start the simulation by subscribing to camera_info once all nodes are connected."""
        if not self._connected and all(
                self.probe.count_publishers(topic) >= publishers
                and self.probe.count_subscribers(topic) >= subscribers
                for topic, (publishers, subscribers) in self.endpoints.items()):
            self._connected = True
            for topic in self.camera_infos:
                self.probe.create_subscription(
                    CameraInfo, topic, lambda message: None, qos.LIST)

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

    answer_s is how long these may take; cpu_s is the processor time of all processes in s, starts
    included, after the last step.
    """

    answer_s: float

    def __init__(self, output: Path) -> None:
        super().__init__(output)
        self.cpu_s = math.nan

    def run_steps(self, step: Callable[[], None], is_finished: Callable[[], bool], frames: int
                  ) -> float:
        """Step and show the table until the end; return the wall time in s."""
        begin_s = time.monotonic()
        with Live(self.table(frames), console=Console(), refresh_per_second=4) as live:
            while not is_finished():
                step()
                live.update(self.table(frames))
        wall_s = time.monotonic() - begin_s
        self.cpu_s = sum(sum(process.cpu_times()[:2]) for process in [
            psutil.Process(),
            *(psutil.Process(process.pid) for process in self.processes.processes.values())])
        # Frames in flight to the recorder.
        self.probe.spin_for(1.0)
        return wall_s

    def await_attitudes(self, missing: Callable[[], str]) -> None:
        """Wait until no attitude_imu is missing; HarnessError with what missing() returns."""
        deadline_s = time.monotonic() + self.answer_s
        while text := missing():
            self.probe.spin_once(0.1)
            ended = self.processes.ended()
            if ended or time.monotonic() > deadline_s:
                raise HarnessError(
                    f'{", ".join(ended)} ended early' if ended else
                    f'no attitude_imu of {text} within {self.answer_s:g} s: see '
                    f'{self.log_folder}')


def draw_if_possible(picture: Path, draw: Callable[[], None]) -> str:
    """Return the path of the picture, or which library drawing it needs."""
    try:
        draw()
    except MissingLibraryError as error:
        return str(error)
    return str(picture)


def start_time_s() -> float:
    """
    Return when the demo began, UNIX time in s.

    That is the start of this process, or the end of the compilation where it runs first.
    """
    if not machine_code_folder() or cached_share(package_code()):
        return psutil.Process().create_time()
    print('compiling for this machine, for a minute, and only once', file=sys.stderr)
    # When this fails, the nodes compile for themselves.
    subprocess.run(module_command('startracker_ros.warm_up'), env=node_environment())
    return time.time()


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
        message = decode(record.type_name, record.data)
        yield record, ns_from_stamp(message.header.stamp), message
