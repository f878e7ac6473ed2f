# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a first run meets: nothing compiled yet, a folder that holds something else."""

import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from limits import HANGS_S
import pytest
import rclpy
from startracker_evaluation.harness.random_transitions import NodeManager
import startracker_ros
from startracker_ros.ros.diagnostics import Diagnostics, OK
from startracker_ros.ros.processes import node_environment, NodeProcesses


NOWHERE = """
from startracker_ros.core import machine_code
machine_code._folders = list
from startracker_ros.ros.nodes.star_tracker import main
main()
"""


@pytest.mark.parametrize('run, reason', [
    (['-m', 'startracker_ros.ros.nodes.star_tracker'], 'for a minute, and only once'),
    (['-c', NOWHERE], 'at each start: no folder to keep it in can be written')])
def test_a_node_says_that_it_compiles_and_can_be_ended(probe, tmp_path, run, reason):
    empty = str(tmp_path / 'none') if '-m' in run else ''
    processes = NodeProcesses(tmp_path, {'NUMBA_CACHE_DIR': empty})
    process = processes.run('star_tracker', [sys.executable, *run])
    try:
        # Before any camera_info, and while it compiles: the log and the diagnostics.
        status = probe.wait_diagnostic(reason)
        assert status.level == DiagnosticStatus.WARN and status.message.startswith('compiling')
        log = tmp_path / 'star_tracker.log'
        probe.wait(lambda: reason in log.read_text(), 'the log')
        assert 'ready' not in log.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(HANGS_S) == 0
        assert 'Traceback' not in log.read_text()
    finally:
        process.kill()
        process.wait(HANGS_S)


def test_a_node_is_configuring_while_it_compiles(probe, tmp_path):
    processes = NodeProcesses(tmp_path, {'NUMBA_CACHE_DIR': str(tmp_path / 'none')})
    process = processes.start('star_tracker', {'autostart': False})
    try:
        manager = NodeManager(probe)
        assert manager.state('star_tracker') == State.PRIMARY_STATE_UNCONFIGURED
        probe.wait_diagnostic('unconfigured')
        client = probe.create_client(ChangeState, '/star_tracker/change_state')
        probe.wait(client.service_is_ready, 'the service')
        future = client.call_async(ChangeState.Request(
            transition=Transition(id=Transition.TRANSITION_CONFIGURE)))
        probe.wait(lambda: manager.state('star_tracker') == State.TRANSITION_STATE_CONFIGURING,
                   'configuring')
        # The node subscribes when it is ready; meanwhile it reports, and rejects.
        assert not probe.count_subscribers('camera_info')
        probe.wait_diagnostic('for this machine')
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
                           Transition.TRANSITION_ON_CONFIGURE_SUCCESS):
            assert not manager.change('star_tracker', transition)
        assert not future.done()
        assert manager.state('star_tracker') == State.TRANSITION_STATE_CONFIGURING
        reports = len(probe.statuses())
        probe.wait(lambda: len(probe.statuses()) >= reports + 6, 'further diagnostics')
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANGS_S) == 0
        assert 'Traceback' not in (tmp_path / 'star_tracker.log').read_text()
    finally:
        process.kill()
        process.wait(HANGS_S)


def test_a_function_that_is_compiled_is_reported_while_the_executor_waits(probe):
    node = rclpy.create_node('busy', context=probe.context)
    # Nothing executes the timer of this node: its executor waits.
    diagnostics = Diagnostics(node, 'work', 'star_tracker')
    diagnostics.report(OK, 'works')
    diagnostics.say_compiling('first')
    assert probe.wait_diagnostic('compiling first').level == DiagnosticStatus.WARN
    diagnostics.say_compiling('second')
    probe.wait_diagnostic('compiling second')
    diagnostics.publish()
    diagnostics.say_compiling('')
    probe.forget()
    diagnostics.publish()
    assert probe.wait_diagnostic('works').level == DiagnosticStatus.OK
    diagnostics.say_compiling('third')
    probe.wait_diagnostic('compiling third')
    node.destroy_node()


def test_a_process_imports_the_package_of_its_parent(tmp_path):
    decoy = tmp_path / 'startracker_ros'
    decoy.mkdir()
    (decoy / '__init__.py').write_text('raise SystemExit("not this one")\n')
    done = subprocess.run([sys.executable, '-m', 'startracker_ros', '--version'], cwd=tmp_path,
                          env=node_environment(), stdout=subprocess.PIPE, text=True,
                          timeout=HANGS_S)
    assert done.stdout.split()[-1] == startracker_ros.__version__
