# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes as processes, with the environment that DDS needs for images."""

from collections.abc import Sequence
import functools
import os
from pathlib import Path
import signal
import site
import socket
import subprocess
import sys

from startracker_ros.core.options import yaml_value
from startracker_ros.ros.executables import EXECUTABLES
from startracker_ros.ros.memory import profile_variable, PROFILE_VARIABLES

_ROOT = Path(__file__).parents[2]
"""Where the package is imported from."""
_DOMAINS = 100
"""1 to 100: with the ports of a higher one those of Linux for outgoing connections begin."""
_CLAIMS: list[socket.socket] = []
"""What holds the domains that this process has taken."""


class HarnessError(RuntimeError):
    """Nodes did not start, connect, respond or end cleanly; the text names their logs."""


def share_folder() -> Path:
    """Return share/startracker_ros of the install, or the source tree when run from there."""
    for prefix in (*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix):
        share = Path(prefix) / 'share' / 'startracker_ros'
        if prefix and share.is_dir():
            return share
    return _ROOT


def node_environment() -> dict[str, str]:
    """
    Return this process's environment with what the nodes need; variables that are set stay.

    Nodes import the same package as this process. Images need a larger shared-memory segment
    than the default one, and 2 MiB buffers without page faults. Of what threads have freed, the
    C library gives back all only where they share one arena. Threads of NumPy would compete with
    the nodes for the cores.
    """
    root = str(_ROOT)
    paths = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    if root not in (*paths, *site.getsitepackages()):
        paths.insert(0, root)
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    if sys.prefix not in prefixes:
        prefixes.append(sys.prefix)
    defaults = {
        'MALLOC_ARENA_MAX': '1',
        'MALLOC_MMAP_THRESHOLD_': '1073741824',
        'MALLOC_TRIM_THRESHOLD_': '1073741824',
        'MALLOC_TOP_PAD_': '67108864',
        'OMP_NUM_THREADS': '1',
        'OPENBLAS_NUM_THREADS': '1',
        'PYTHONSAFEPATH': '1',
    }
    if not any(map(os.environ.get, PROFILE_VARIABLES)):
        defaults[profile_variable()] = str(share_folder() / 'config' / 'fastdds.xml')
    return {**defaults, **os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, paths)),
            'AMENT_PREFIX_PATH': os.pathsep.join(filter(None, prefixes))}


def claim_domain(domain: int) -> bool:
    """Return whether a ROS domain is this process's from now on: no other process took it so."""
    # A name without a file: the kernel gives it to one socket and frees it with the process.
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f'\0startracker_ros/domain/{domain}')
    except OSError:
        claim.close()
        return False
    _CLAIMS.append(claim)
    return True


def take_domain() -> str:
    """
    Return the id of a ROS domain that no other process on this machine has taken.

    It is this process's until it ends; RuntimeError where all are taken.
    """
    for offset in range(_DOMAINS):
        domain = 1 + (os.getpid() + offset) % _DOMAINS
        if claim_domain(domain):
            return str(domain)
    raise RuntimeError(f'all {_DOMAINS} ROS domains are taken: end some processes of the tests')


@functools.cache
def _own_domain() -> str:
    return take_domain()


def set_environment(*, isolated: bool) -> None:
    """
    Set the environment of the nodes in this process, which runs its own ones with it.

    Discovery is limited to this machine unless ROS_AUTOMATIC_DISCOVERY_RANGE is set. isolated
    selects a ROS domain that is this process's alone.
    """
    if isolated:
        os.environ['ROS_DOMAIN_ID'] = _own_domain()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.update(node_environment())


def node_command(node: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs one node; KeyError for an unknown name."""
    return module_command(EXECUTABLES[node], arguments)


def module_command(module: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs a Python module."""
    return [sys.executable, '-m', module, *arguments]


def parameter_arguments(parameters: dict[str, object]) -> list[str]:
    """Return --ros-args that set parameters."""
    arguments = ['--ros-args']
    for name, value in parameters.items():
        arguments += ['-p', f'{name}:={yaml_value(value)}']
    return arguments


class NodeProcesses:
    """
    A group of processes by name, ended together; used as a context manager.

    What a process prints goes into log_folder/NAME.log; environment is added to that of the
    nodes.
    """

    def __init__(self, log_folder: Path, environment: dict[str, str] | None = None) -> None:
        self.log_folder = log_folder
        self.environment = {**node_environment(), **(environment or {})}
        self.processes: dict[str, subprocess.Popen] = {}

    def start(self, node: str, parameters: dict[str, object] | None = None,
              extra: Sequence[str] = (), *, namespace: str = '') -> subprocess.Popen:
        """Start a node, or start it again; in a namespace its name is NAMESPACE.NODE."""
        arguments = parameter_arguments(parameters or {})
        name = node
        if namespace:
            name = f'{namespace}.{node}'
            arguments += ['-r', f'__ns:=/{namespace}']
        # Last: they may end the arguments of ROS.
        return self.run(name, node_command(node, [*arguments, *extra]))

    def run(self, name: str, command: Sequence[str]) -> subprocess.Popen:
        """Run a command under a name."""
        # In a group of its own: a terminal would send Ctrl-C to it, and this process ends it.
        with open(self.log_folder / f'{name}.log', 'ab') as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                       env=self.environment, process_group=0)
        self.processes[name] = process
        return process

    def is_running(self, name: str) -> bool:
        """Return whether a process was started and has not ended."""
        process = self.processes.get(name)
        return process is not None and process.poll() is None

    def pid(self, name: str) -> int:
        """Return a process id."""
        return self.processes[name].pid

    def ended(self) -> list[str]:
        """Return the names of the processes that have ended."""
        return [name for name in self.processes if not self.is_running(name)]

    def signal(self, number: signal.Signals, *names: str) -> None:
        """Send a signal to processes."""
        for name in names:
            self.processes[name].send_signal(number)

    def kill(self, *names: str) -> None:
        """Send SIGKILL to processes one after another and wait for their ends."""
        for name in names:
            self.processes[name].kill()
            self.processes[name].wait()

    def stop(self, timeout_s: float = 15.0) -> dict[str, int]:
        """End all by SIGTERM, by SIGKILL after timeout_s; return their exit codes."""
        for process in self.processes.values():
            if process.poll() is None:
                # A stopped process handles SIGTERM only after it continues.
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGTERM)
        codes = {}
        for name, process in self.processes.items():
            try:
                codes[name] = process.wait(timeout=timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                codes[name] = process.wait()
        return codes

    def __enter__(self) -> 'NodeProcesses':
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
