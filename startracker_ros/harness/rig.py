"""Nodes as processes in a domain of their own, and a node here that talks with them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
from types import TracebackType
from typing import Self

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from startracker_ros.harness.processes import node_environment, NodeProcesses
from startracker_ros.ros import qos


@contextmanager
def log_folder(purpose: str) -> Iterator[Path]:
    """Lend a folder for logs, which stays where an error leaves it."""
    folder = Path(tempfile.mkdtemp(prefix=f'startracker_{purpose}_'))
    yield folder
    shutil.rmtree(folder)


class Rig:
    """
    Starts, signals and kills nodes, and listens; to be used as a context manager.

    folder takes the logs; environment is added to that of the nodes.
    """

    def __init__(self, folder: Path, environment: dict[str, str] | None = None) -> None:
        os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        os.environ.update(node_environment())
        domain = 1 + os.getpid() % 100
        self.folder = folder
        self._environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), **(environment or {})}
        self._processes = NodeProcesses(folder, self._environment)
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node('rig', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def start_node(self, node: str, parameters: dict[str, object] | None = None) -> None:
        """Start a node, or start it again."""
        self._processes.start(node, parameters)

    def start_module(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Start a Python module in the place of a node, under a name."""
        self._processes.run(name, [sys.executable, '-m', module, *arguments])

    def run_module(self, module: str, *arguments: str) -> subprocess.Popen:
        """Start a Python module in the environment of the nodes."""
        return subprocess.Popen([sys.executable, '-m', module, *arguments],
                                env=self._environment, stdin=subprocess.DEVNULL)

    def runs(self, node: str) -> bool:
        """Return whether a node was started and has not ended."""
        process = self._processes.processes.get(node)
        return process is not None and process.poll() is None

    def pid(self, node: str) -> int:
        """Return the process id of a node."""
        return self._processes.processes[node].pid

    def kill(self, *nodes: str) -> None:
        """End processes as the kernel does, at once."""
        for node in nodes:
            self._processes.processes[node].kill()
            self._processes.processes[node].wait()

    def signal(self, number: signal.Signals, *nodes: str) -> None:
        """Send a signal, as SIGSTOP, to nodes."""
        for node in nodes:
            self._processes.processes[node].send_signal(number)

    def listen(self, message_type: type, topic: str, take: Callable, *, raw: bool = False
               ) -> None:
        """Subscribe; raw messages are serialized ones."""
        self.node.create_subscription(message_type, topic, take, qos.LIST, raw=raw)

    def spin(self, timeout_s: float) -> None:
        """Take one message, if one comes in time."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def close(self) -> None:
        """End all that was started."""
        self.signal(signal.SIGCONT, *filter(self.runs, self._processes.processes))
        self._processes.stop()
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()
