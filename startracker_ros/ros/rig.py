# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Node processes and a probe that observes them, started and ended together."""

from contextlib import ExitStack
from pathlib import Path
import shutil
import tempfile
from types import TracebackType
from typing import Self

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from startracker_ros.core.ctrl_c import interrupted_by_ctrl_c
from startracker_ros.ros.probe import Probe
from startracker_ros.ros.processes import NodeProcesses, set_environment


class LogFolder:
    """A temporary folder for logs, deleted at the end unless keep is set or an error occurs."""

    def __init__(self, purpose: str) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=f'startracker_{purpose}_'))
        self.keep = False

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if kind is None and not self.keep:
            shutil.rmtree(self.path)


class Rig:
    """
    Node processes and a probe; a context manager that ends both.

    log_folder receives what the processes print; environment is added to theirs. isolated puts
    all in a ROS domain of this process, not in that of the user. timeout_s limits the waits of
    the probe.
    """

    def __init__(self, log_folder: Path, environment: dict[str, str] | None = None, *,
                 isolated: bool = True, name: str = 'rig', timeout_s: float = 30.0) -> None:
        set_environment(isolated=isolated)
        self.log_folder = log_folder
        self.processes = NodeProcesses(log_folder, environment)
        self._context = Context()
        # SIGTERM ends the wait of the probe with an exception, so that the processes are ended.
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.SIGTERM)
        self.probe = Probe(name, context=self._context, timeout_s=timeout_s,
                           log_folder=log_folder)
        self._has_probe = True

    def stop(self, timeout_s: float = 15.0) -> dict[str, int]:
        """Remove the probe, then end the processes; return their exit codes."""
        try:
            self.remove_probe()
        finally:
            codes = self.processes.stop(timeout_s)
        return codes

    def remove_probe(self) -> None:
        """
        Remove the probe from DDS, after its last use; a second call does nothing.

        Before the nodes end: with one that ended while it received, what is sent to all may wait
        for ever (eProsima/Fast-DDS issue 6485).
        """
        if self._has_probe:
            self._has_probe = False
            self.probe.destroy_node()
            rclpy.try_shutdown(context=self._context)

    def __enter__(self) -> Self:
        self._open = ExitStack()
        self._open.enter_context(interrupted_by_ctrl_c())
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        with self._open:
            self.stop()
