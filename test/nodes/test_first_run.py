# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a first run meets: a folder that holds something else."""

import subprocess
import sys

from limits import HANGS_S
import startracker_ros
from startracker_ros.ros.processes import node_environment


def test_a_process_imports_the_package_of_its_parent(tmp_path):
    decoy = tmp_path / 'startracker_ros'
    decoy.mkdir()
    (decoy / '__init__.py').write_text('raise SystemExit("not this one")\n')
    done = subprocess.run([sys.executable, '-m', 'startracker_ros', '--version'], cwd=tmp_path,
                          env=node_environment(), stdout=subprocess.PIPE, text=True,
                          timeout=HANGS_S)
    assert done.stdout.split()[-1] == startracker_ros.__version__
