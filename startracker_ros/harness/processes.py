"""Nodes as processes of their own, with the environment that makes DDS fast."""

from collections.abc import Sequence
import os
from pathlib import Path
import signal
import site
import subprocess
import sys

from startracker_ros.executables import EXECUTABLES
from startracker_ros.options import yaml_value

_ROOT = Path(__file__).parents[2]
"""Where the package is imported from."""


class RigError(RuntimeError):
    """The nodes did not come up; the text says where their logs are."""


def share_folder() -> Path:
    """Return share/startracker_ros of the install, or the source tree when run from there."""
    for prefix in (*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix):
        share = Path(prefix) / 'share' / 'startracker_ros'
        if prefix and share.is_dir():
            return share
    return _ROOT


def node_environment() -> dict[str, str]:
    """
    Return this process's environment with what the nodes need.

    They import the package that this process has, whatever folder they are started in. Image
    messages want a shared-memory segment larger than the stock one, and fresh
    2 MiB buffers without page faults; NumPy's threads would only fight over the cores.
    What the user has set stays.
    """
    root = str(_ROOT)
    paths = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    if root not in (*paths, *site.getsitepackages()):
        paths.insert(0, root)
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    if sys.prefix not in prefixes:
        prefixes.append(sys.prefix)
    defaults = {
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(share_folder() / 'config' / 'fastdds.xml'),
        'MALLOC_MMAP_THRESHOLD_': '1073741824',
        'MALLOC_TRIM_THRESHOLD_': '1073741824',
        'MALLOC_TOP_PAD_': '67108864',
        'OMP_NUM_THREADS': '1',
        'OPENBLAS_NUM_THREADS': '1',
        'PYTHONSAFEPATH': '1',
    }
    return {**defaults, **os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, paths)),
            'AMENT_PREFIX_PATH': os.pathsep.join(filter(None, prefixes))}


def node_command(node: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs one node; KeyError for an unknown name."""
    return [sys.executable, '-m', EXECUTABLES[node], *arguments]


def parameter_arguments(parameters: dict[str, object]) -> list[str]:
    """Return --ros-args that set parameters."""
    arguments = ['--ros-args']
    for name, value in parameters.items():
        arguments += ['-p', f'{name}:={yaml_value(value)}']
    return arguments


class NodeProcesses:
    """A group of nodes, ended together; used as a context manager."""

    def __init__(self, log_folder: Path, environment: dict[str, str] | None = None) -> None:
        self.log_folder = log_folder
        self._environment = {**node_environment(), **(environment or {})}
        self.processes: dict[str, subprocess.Popen] = {}

    def start(self, node: str, parameters: dict[str, object] | None = None,
              extra: Sequence[str] = (), *, namespace: str = '') -> subprocess.Popen:
        """Start one node; what it prints goes into the log folder."""
        arguments = [*parameter_arguments(parameters or {}), *extra]
        name = node
        if namespace:
            name = f'{namespace}.{node}'
            arguments += ['-r', f'__ns:=/{namespace}']
        return self.run(name, node_command(node, arguments))

    def run(self, name: str, command: Sequence[str]) -> subprocess.Popen:
        """Run a command under a name; what it prints goes into the log folder."""
        with open(self.log_folder / f'{name}.log', 'ab') as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                       env=self._environment)
        self.processes[name] = process
        return process

    def failed(self) -> list[str]:
        """Return the names of the nodes that have ended."""
        return [name for name, process in self.processes.items() if process.poll() is not None]

    def stop(self, patience_s: float = 15.0) -> dict[str, int]:
        """End all nodes by SIGTERM, after patience_s by SIGKILL; return their exit codes."""
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        codes = {}
        for name, process in self.processes.items():
            try:
                codes[name] = process.wait(timeout=patience_s)
            except subprocess.TimeoutExpired:
                process.kill()
                codes[name] = process.wait()
        return codes

    def __enter__(self) -> 'NodeProcesses':
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
