# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A process that hangs with the interpreter locked ends all the same."""

import subprocess
import sys

from limits import HANGS_S
import pytest

HANG = """
import ctypes, sys
from startracker_ros.ros.shutdown import exit_after
exit_after(float(sys.argv[1]), int(sys.argv[2]))
ctypes.PyDLL(None).sleep(600)  # keeps the lock of the interpreter
"""


@pytest.mark.parametrize('code', [0, 3])
def test_a_hanging_process_ends_with_its_code(code):
    done = subprocess.run([sys.executable, '-c', HANG, '0.3', str(code)], timeout=HANGS_S)
    assert done.returncode == code


def test_a_process_that_ends_by_itself_is_not_disturbed():
    ends = HANG.replace('ctypes.PyDLL(None).sleep(600)', 'sys.exit(7)')
    done = subprocess.run([sys.executable, '-c', ends, '300', '0'], timeout=HANGS_S)
    assert done.returncode == 7
