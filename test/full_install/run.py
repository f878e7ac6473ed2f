# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The package in a full install of ROS 2: launch_testing and the commands of ros2.

Run with the workspace sourced: `make test-ros`. What is not installed is named in one line and
left out; status 1 where something that was run fails.
"""

from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

ROOT = Path(__file__).parents[2]
BAG = str(ROOT / 'bags' / 'slew')
LAUNCH_FILES = sorted(path.name for path in (ROOT / 'launch').iterdir())
LIMIT_S = 600
POLICIES = [str(ROOT / 'config' / name) for name in (
    'security_policy.xml', 'security_policy_ground.xml')]
KEYSTORE = tempfile.TemporaryDirectory()

# By what each needs: the command, and words that it has to print.
RUNS = [
    (('ros2',), ['ros2', 'pkg', 'executables', 'startracker_ros'], 'composed_pipeline'),
    *((('ros2', 'launch_ros'), ['ros2', 'launch', 'startracker_ros', name, '--show-args'],
       'params_file') for name in LAUNCH_FILES),
    (('ros2', 'ros2bag', 'rosbag2_storage_mcap'), ['ros2', 'bag', 'info', BAG],
     'tracker_state'),
    (('startracker',), ['startracker', 'info', BAG], 'tracker_state'),
    # It ends by itself: no process is started again.
    (('ros2', 'launch_ros'), ['ros2', 'launch', 'startracker_ros', 'pipeline.launch.py',
                              'log_level:=bogus'],
     'ended with status 2 and is not started again'),
    (('ros2', 'sros2'), ['ros2', 'security', 'generate_artifacts', '-k', KEYSTORE.name, '-p',
                         *POLICIES], ''),
    *((('ros2', 'sros2'), ['ros2', 'security', 'list_enclaves', KEYSTORE.name],
       f'/startracker_ros/{node}') for node in ('star_tracker', 'operator', 'bag_player')),
    (('launch_testing', 'launch_ros'), [
        sys.executable, '-m', 'launch_testing.launch_test',
        str(Path(__file__).with_name('launch_demo.py'))], ''),
]


def is_there(name: str) -> bool:
    """Return whether a command, a Python package or a package of the ament index is installed."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return bool(shutil.which(name) or find_spec(name) or any(
        Path(prefix, 'share', name).is_dir() for prefix in prefixes if prefix))


def main() -> int:
    """Run what can be run; return the exit status."""
    failed, missing, ran = 0, set(), 0
    for needs, command, words in RUNS:
        absent = {name for name in needs if not is_there(name)}
        if absent:
            missing |= absent
            continue
        done = subprocess.run(command, text=True, stdin=subprocess.DEVNULL, timeout=LIMIT_S,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        holds = done.returncode == 0 and words in done.stdout
        print('ok    ' if holds else 'FAILED', ' '.join(command), flush=True)
        if not holds:
            print(done.stdout, flush=True)
        failed, ran = failed + (not holds), ran + 1
    left_out = f'; {len(RUNS) - ran} not run, for want of {", ".join(sorted(missing))}'
    print(f'{ran - failed} passed, {failed} failed{left_out if missing else ""}')
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
