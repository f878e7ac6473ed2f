# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Node processes that are forked from one that has imported all nodes.

Each is a process of its own, with its own arguments, environment, DDS and end; only the two
seconds of imports are spent once. `python fork_server.py DESCRIPTOR` is the server.
"""

from collections.abc import Sequence
import ctypes
import gc
from importlib import import_module
import inspect
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback

from startracker_ros.ros.processes import NodeProcesses

_MAX_REQUEST_BYTES = 1 << 18
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_PDEATHSIG = 1
_POLL_S = 0.005
_END_S = 300.0
# Tests wait for diagnostics, which come once a second by default.
_OFTEN = {'diagnostic_updater.period': 0.1}


class ForkedProcess:
    """A process with the methods of subprocess.Popen that the harness and its tests use."""

    def __init__(self, pid: int, command: Sequence[str]) -> None:
        self.pid, self.args = pid, command
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float = float('inf')) -> int:
        """Return the exit code; subprocess.TimeoutExpired after a timeout in s."""
        deadline_s = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline_s:
                raise subprocess.TimeoutExpired(self.args, timeout)
            time.sleep(_POLL_S)
        return self.returncode

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """Starts processes of modules of the package."""

    def __init__(self) -> None:
        # The server leaves its children to the nearest ancestor that adopts: this process.
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        self._connection, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())], stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()])

    def start(self, command: Sequence[str], log: Path, environment: dict[str, str]
              ) -> ForkedProcess:
        """Run a command [python, -m, MODULE, ...]; what it prints is appended to a file."""
        request = json.dumps([*command[2:3], command[3:], environment]).encode()
        with open(log, 'ab') as file:
            socket.send_fds(self._connection, [request], [file.fileno()])
        pid = int(self._connection.recv(32))
        assert self._connection.recv(32) == b'orphaned'
        return ForkedProcess(pid, command)

    def close(self) -> None:
        """End the server."""
        self._connection.close()
        self._server.wait(_END_S)


class ForkedNodes(NodeProcesses):
    """Node processes that are forked; other commands are run as they are."""

    server: ForkServer | None = None
    """That of all groups, started with the first node."""

    def start(self, node: str, parameters: dict[str, object] | None = None,
              extra: Sequence[str] = (), *, namespace: str = '') -> subprocess.Popen:
        """Start a node that publishes diagnostics often."""
        return super().start(node, _OFTEN | (parameters or {}), extra, namespace=namespace)

    def run(self, name: str, command: Sequence[str]) -> subprocess.Popen | ForkedProcess:
        """Run a command under a name."""
        if command[1] != '-m':
            return super().run(name, command)
        ForkedNodes.server = ForkedNodes.server or ForkServer()
        self.processes[name] = self.server.start(
            command, self.log_folder / f'{name}.log', self.environment)
        return self.processes[name]


def _serve(connection: socket.socket) -> str:
    """Fork for each request; return in the new process, ready to run it, its module."""
    while True:
        request, descriptors, _, _ = socket.recv_fds(connection, _MAX_REQUEST_BYTES, 1)
        if not request:
            sys.exit()
        # Twice, so that what has started the server can wait for the end of the process.
        between = os.fork()
        if between == 0:
            between, pid = os.getpid(), os.fork()
            if pid:
                connection.send(str(pid).encode())
                os._exit(0)
            connection.close()
            _end_with_adopter(between)
            break
        os.waitpid(between, 0)
        connection.send(b'orphaned')
        os.close(descriptors[0])
    module, arguments, environment = json.loads(request)
    for output in (1, 2):
        os.dup2(descriptors[0], output)
    os.close(descriptors[0])
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [import_module(module).__file__ or module, *arguments]
    return module


def _end_with_adopter(between: int) -> None:
    """Let this process end with the one of the tests, should that be killed."""
    while os.getppid() == between:
        time.sleep(0.001)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def _load() -> None:
    """Import all nodes, with what they use."""
    import cv2
    from startracker_ros.ros.executables import EXECUTABLES
    for module in EXECUTABLES.values():
        import_module(module)
    # What rclpy does at the first use: it finds the module of each line that logs among all of
    # them, and imports the C code of each type.
    inspect.getframeinfo(inspect.currentframe())
    for name in [name for name in sys.modules if name.endswith(('.msg', '.srv'))]:
        for value in vars(sys.modules[name]).values():
            if hasattr(value, '__import_type_support__'):
                value.__import_type_support__()
    # Threads are missing in what is forked: the two of the tracing that rclpy is linked with are
    # idle, those of OpenCV would be waited for.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    cv2.setNumThreads(threads)
    assert threading.active_count() == 1
    gc.collect()
    gc.freeze()


def _run(module: str) -> None:
    """Run main() of a module and end the process with its exit code."""
    try:
        code = import_module(module).main()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    if isinstance(code, str):
        print(code, file=sys.stderr)
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # The end of the interpreter would copy all memory that is shared with the server.
    os._exit(code or 0)


if __name__ == '__main__':
    _load()
    _run(_serve(socket.socket(fileno=int(sys.argv[1]))))
