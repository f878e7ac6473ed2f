"""What a first run meets: nothing compiled yet, a folder that holds something else."""

import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from limits import HANGS_S
import pytest
import startracker_ros
from startracker_ros.harness.processes import node_environment, NodeProcesses


NOWHERE = """
from startracker_ros import machine_code
machine_code._folders = list
from startracker_ros.ros.nodes.centroid_extractor import main
main()
"""


@pytest.mark.parametrize('run, reason', [
    (['-m', 'startracker_ros.ros.nodes.centroid_extractor'], 'for a minute, and only once'),
    (['-c', NOWHERE], 'at each start: no folder to keep it in can be written')])
def test_a_node_says_that_it_compiles_and_can_be_ended(probe, tmp_path, run, reason):
    empty = str(tmp_path / 'none') if '-m' in run else ''
    processes = NodeProcesses(tmp_path, {'NUMBA_CACHE_DIR': empty})
    process = processes.run('centroid_extractor', [sys.executable, *run])
    try:
        # Before any camera_info, and while it compiles: the log and the diagnostics.
        status = probe.wait_diagnostic(reason)
        assert status.level == DiagnosticStatus.WARN and status.message.startswith('compiling')
        log = tmp_path / 'centroid_extractor.log'
        assert reason in log.read_text() and 'ready' not in log.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(HANGS_S) == 0
        assert 'Traceback' not in log.read_text()
    finally:
        process.kill()
        process.wait(HANGS_S)


def test_a_process_imports_the_package_of_its_parent(tmp_path):
    decoy = tmp_path / 'startracker_ros'
    decoy.mkdir()
    (decoy / '__init__.py').write_text('raise SystemExit("not this one")\n')
    done = subprocess.run([sys.executable, '-m', 'startracker_ros', '--version'], cwd=tmp_path,
                          env=node_environment(), stdout=subprocess.PIPE, text=True,
                          timeout=HANGS_S)
    assert done.stdout.split()[-1] == startracker_ros.__version__
