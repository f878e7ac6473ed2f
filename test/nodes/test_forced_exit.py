"""A process that hangs with the interpreter locked ends all the same."""

import subprocess
import sys
import time

import pytest

HANG = """
import ctypes, sys
from startracker_ros.ros.forced_exit import exit_after
exit_after(float(sys.argv[1]), int(sys.argv[2]))
ctypes.PyDLL(None).sleep(60)  # keeps the lock of the interpreter
"""


@pytest.mark.parametrize('code', [0, 3])
def test_a_hanging_process_ends_with_its_code(code):
    begin_s = time.monotonic()
    done = subprocess.run([sys.executable, '-c', HANG, '0.3', str(code)], timeout=50)
    assert done.returncode == code and time.monotonic() - begin_s < 40


def test_a_process_that_ends_by_itself_is_not_disturbed():
    ends = HANG.replace('ctypes.PyDLL(None).sleep(60)', 'sys.exit(7)')
    assert subprocess.run([sys.executable, '-c', ends, '30', '0']).returncode == 7
