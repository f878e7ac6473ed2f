# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core without Python: CMake builds it, ctest and an example show that it works."""

import os
from pathlib import Path
import shutil
import subprocess
import sysconfig

from limits import HANGS_S
from native_core import compiler, ROOT
import numpy as np
from skies import SMALL_CAMERA as CAMERA, START_NS
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.stored_arrays import write_arrays
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

YEAR = 2026.0
PERIOD_S = 0.1


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
    compare_example(tmp_path / 'example', tmp_path)


def compare_example(program: Path, folder: Path) -> None:
    """Compare what examples/main.c prints of simulated images with the package."""
    with (folder / 'sky').open('w+b') as file:
        write_arrays(file, sky_arrays(CAMERA, YEAR))
    simulator = SkySimulator(CAMERA, motion_from_options(MotionOptions(ra_deg=80.0, dec_deg=20.0)),
                             load_catalog(), YEAR, detector_options=DetectorOptions(bit_depth=8))
    tracker, images, expected = StarTracker(CAMERA, YEAR, aberration='none'), [], []
    for number in range(5):
        image = simulator.frame(number * PERIOD_S).image
        images.append(folder / f'{number}.pgm')
        images[-1].write_bytes(b'P5\n%d %d\n255\n' % (CAMERA.width, CAMERA.height)
                               + image.tobytes())
        found = tracker.process(START_NS + round(1e9 * number * PERIOD_S), image).attitude
        expected.append(np.full(16, np.nan) if found is None else np.concatenate([
            found.quaternion, found.covariance_sensor.ravel(), found.protection_rad]))
    done = subprocess.run([program, folder / 'sky', str(CAMERA.fx), str(PERIOD_S), *images],
                          capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    printed = [[float(word) for word in line.split()[2:] if not word[0].isalpha() or word == 'nan']
               for line in done.stdout.splitlines()]
    np.testing.assert_allclose(printed, expected, rtol=1e-9, atol=1e-15)
    assert np.isfinite(expected).all(axis=1).sum() == 3
