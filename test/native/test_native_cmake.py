# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core without Python: CMake builds it, and ctest compares it with the corpus."""

import os
import shutil
import subprocess
import sysconfig

from limits import HANGS_S
from native_core import compiler, ROOT


def test_cmake_builds_and_tests_it_without_python(tmp_path):
    cmake, ctest = (shutil.which(name, path=os.pathsep.join(
        [sysconfig.get_path('scripts'), os.environ['PATH']])) for name in ('cmake', 'ctest'))
    command = ' '.join(compiler().command)
    environment = {**os.environ, 'CXX': command}
    if compiler().kind == 'zig':
        environment['CC'] = command.removesuffix('c++') + 'cc'
    for arguments in ([cmake, '-S', ROOT / 'native', '-B', tmp_path],
                      [cmake, '--build', tmp_path, '--parallel', '2'],
                      [ctest, '--test-dir', tmp_path, '--output-on-failure']):
        done = subprocess.run(arguments, env=environment, capture_output=True, text=True,
                              timeout=HANGS_S)
        assert done.returncode == 0, done.stdout + done.stderr
    assert '100% tests passed' in done.stdout
    flight = (tmp_path / 'libstartracker.a').read_bytes()
    # The simulator is not for flight.
    assert b'st_track' in flight
    assert b'st_read_out' not in flight
