# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes in processes, and a probe that communicates with them over DDS."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fork_server import ForkedNodes
from limits import HANGS_S
import pytest
from startracker_ros.ros.processes import NodeProcesses, set_environment

# Tests also start processes of their own, with the environment of this one.
set_environment(isolated=True)

from startracker_ros.ros.probe import Probe  # noqa: E402, I100
from startracker_ros.ros.rig import Rig  # noqa: E402


@pytest.fixture(scope='session', autouse=True)
def forked() -> Iterator[None]:
    """Fork the nodes of all rigs from a process that has loaded them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('startracker_ros.ros.rig.NodeProcesses', ForkedNodes)
        yield
    if ForkedNodes.server is not None:
        ForkedNodes.server.close()


@contextmanager
def observed_rig(folder: Path) -> Iterator[Rig]:
    """Return a rig with its logs in a folder; its processes have to end cleanly."""
    with Rig(folder, name='probe', timeout_s=HANGS_S) as rig:
        rig.probe.collect_diagnostics()
        yield rig
        codes = rig.stop(HANGS_S)
        logs = {path.name: path.read_text() for path in folder.glob('*.log')}
        assert all(code == 0 for code in codes.values()), (codes, logs)
        assert not any('Traceback' in text for text in logs.values()), logs


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """Return a rig with its logs in tmp_path."""
    with observed_rig(tmp_path) as rig:
        yield rig


@pytest.fixture(scope='module')
def shared_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """Return a rig for all tests of a file; none of them may have one of its own."""
    with observed_rig(tmp_path_factory.mktemp('rig')) as rig:
        yield rig


@pytest.fixture
def probe(rig: Rig) -> Probe:
    """Return the probe of the rig."""
    return rig.probe


@pytest.fixture
def nodes(rig: Rig) -> NodeProcesses:
    """Return the processes of the rig."""
    return rig.processes
