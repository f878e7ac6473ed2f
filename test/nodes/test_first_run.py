"""What a first run meets: nothing compiled yet, a folder that holds something else."""

import subprocess
import sys

import pytest
from sensor_msgs.msg import CameraInfo
import startracker_ros
from startracker_ros.camera.model import Camera
from startracker_ros.harness.processes import node_environment, NodeProcesses
from startracker_ros.ros import qos
from startracker_ros.ros.messages.camera_info import camera_to_message
from startracker_ros.ros.messages.header import make_header


NOWHERE = """
from startracker_ros import machine_code
machine_code._folders = list
from startracker_ros.ros.nodes.centroid_extractor import main
main()
"""


@pytest.mark.parametrize('run, reason', [
    (['-m', 'startracker_ros.ros.nodes.centroid_extractor'], 'for a minute, and only once'),
    (['-c', NOWHERE], 'at each start: no folder to keep it in can be written')])
def test_a_node_says_that_it_compiles(probe, tmp_path, run, reason):
    empty = str(tmp_path / 'none') if '-m' in run else ''
    # Killed, not ended: it would compile for a minute first.
    processes = NodeProcesses(tmp_path, {'NUMBA_CACHE_DIR': empty})
    process = processes.run('centroid_extractor', [sys.executable, *run])
    try:
        camera_info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
        camera_info.publish(camera_to_message(
            Camera.from_fov(256, 256, 20.0), make_header(1_790_000_000_000_000_000, 'sensor')))
        log = tmp_path / 'centroid_extractor.log'
        probe.wait(lambda: reason in log.read_text(), 'the reason')
    finally:
        process.kill()
        process.wait()


def test_a_process_imports_the_package_of_its_parent(tmp_path):
    decoy = tmp_path / 'startracker_ros'
    decoy.mkdir()
    (decoy / '__init__.py').write_text('raise SystemExit("not this one")\n')
    done = subprocess.run([sys.executable, '-m', 'startracker_ros', '--version'], cwd=tmp_path,
                          env=node_environment(), stdout=subprocess.PIPE, text=True)
    assert done.stdout.split()[-1] == startracker_ros.__version__
