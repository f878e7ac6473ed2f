# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node gives back what it has used to load code and to build."""

import subprocess
import sys

from limits import HANGS_S
import pytest
from startracker_ros.ros.processes import node_environment

# Each prints how many MiB are given back.
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
CODE_OF_LLVM = """
import llvmlite.binding as llvm
from startracker_ros.ros.memory import return_free_memory


def resident():
    of_code, total = False, 0
    for line in open('/proc/self/smaps'):
        if '-' in line.split()[0]:
            of_code = 'libllvmlite' in line and ' r-xp ' in line
        elif of_code and line.startswith('Rss:'):
            total += int(line.split()[1])
    return total / 1024


def emit():
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    return machine.emit_object(llvm.parse_assembly('define i32 @f() { ret i32 7 }'))


first, used = emit(), resident()
return_free_memory()
print(used - resident())
# It works as before.
assert emit() == first
"""


@pytest.mark.parametrize('program, least', [(FREED_BY_A_THREAD, 40), (CODE_OF_LLVM, 5)],
                         ids=['freed by a thread', 'code of LLVM'])
def test_memory_is_given_back(program, least):
    done = subprocess.run([sys.executable, '-c', program], env=node_environment(),
                          capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > least
