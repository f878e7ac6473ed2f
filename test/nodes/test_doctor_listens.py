# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""startracker doctor --listen with a running camera."""

import json
import os
import subprocess
import sys

from limits import HANGS_S
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.images.camera_files import save_camera


def test_doctor_finds_a_live_camera_sound_and_another_file_different(nodes, probe, tmp_path):
    nodes.start('sky_simulator', {'width': 256, 'height': 256, 'fov_deg': 20.0},
                namespace='tracker_1')
    probe.wait(lambda: probe.count_publishers('tracker_1/image_raw'), 'the simulator')
    save_camera(Camera.from_fov(256, 256, 21.0), tmp_path / 'camera.yaml')
    # On a busy machine it takes a while until two images have come.
    for seconds in (4, 32, 256):
        done = subprocess.run(
            [sys.executable, '-m', 'startracker_ros', 'doctor', '--json', '--listen',
             str(seconds), '--namespace', 'tracker_1', '--camera', str(tmp_path / 'camera.yaml')],
            capture_output=True, text=True, timeout=HANGS_S + seconds, env=os.environ)
        rows = {row['check']: row for row in json.loads(done.stdout)['rows']}
        if {'image_raw: rate', 'camera file and camera_info'} <= rows.keys():
            break
    assert done.returncode == 1
    for sound in ('loopback', 'camera_info: field', 'image_raw: encoding', 'image_raw: size',
                  'image_raw: rate', 'image_raw: stamp', 'image_raw: light'):
        assert rows[sound]['holds'], rows
    assert '20.00 x 20.00 deg' in rows['camera_info: field']['result']
    assert not rows['camera file and camera_info']['holds']
