# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node gives back what it has used to build."""

import subprocess
import sys

from limits import HANGS_S
from startracker_ros.ros.processes import node_environment

# It prints how many MiB are given back.
FREED_BY_A_THREAD = """
from threading import Thread

import numpy as np
from startracker_ros.ros.memory import return_free_memory


def resident():
    lines = dict(line.split(':') for line in open('/proc/self/smaps_rollup').readlines()[1:])
    return int(lines['Anonymous'].split()[0]) / 1024


def build():
    # Nothing lies above it.
    np.ones(6 << 20)


before = resident()
thread = Thread(target=build)
thread.start()
thread.join()
return_free_memory()
print(before + 48 - resident())
"""


def test_memory_is_given_back():
    done = subprocess.run([sys.executable, '-c', FREED_BY_A_THREAD], env=node_environment(),
                          capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 40
