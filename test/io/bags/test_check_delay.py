# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The example that finds the delay of a camera behind a gyro."""

from pathlib import Path
import runpy
import subprocess
import sys

from limits import HANGS_S
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skies import START_NS
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.writer import BagWriter

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / 'docs' / 'examples' / 'check_delay.py'
SIGMA_RAD = 2 * ARCSEC
RATE_SIGMA_RAD_S = 1e-4


@pytest.fixture
def check(monkeypatch, capsys):
    def run(bag, *topics):
        monkeypatch.setattr('sys.argv', [str(EXAMPLE), str(bag), *topics])
        runpy.run_path(str(EXAMPLE), run_name='__main__')
        return capsys.readouterr().out
    return run


def found_ms(text):
    words = text.split()
    return float(words[3]), float(words[-2])


def swing(time_s, amplitude_rad):
    """Return the rotation vectors (N, 3) of a camera turned to and fro about a fixed axis."""
    return np.outer(amplitude_rad * np.sin(time_s), [0.6, 0.0, 0.8])


def write(bag, delay_s, amplitude_rad):
    """Write frames at 10 Hz, stamped late by a delay, and rates at 100 Hz with a bias."""
    rng = np.random.default_rng(5)
    times_s = np.arange(0, 10, 0.01)
    angles = swing(times_s, amplitude_rad)
    with BagWriter(bag) as writer:
        for topic in ('/frame_attitude', '/imu'):
            writer.add_topic(topic, 'sensor_msgs/msg/Imu')
        for index in range(1, len(times_s)):
            stamp_ns = START_NS + index * 10_000_000
            # About a fixed axis: the rate is the derivative of the angle.
            rate = ((angles[index] - angles[index - 1]) / 0.01 + [2e-5, -1e-5, 0]
                    + RATE_SIGMA_RAD_S * rng.standard_normal(3))
            message = cdr.gyro_imu(stamp_ns, 'camera', rate, RATE_SIGMA_RAD_S)
            writer.write('/imu', message, stamp_ns, stamp_ns)
            if index % 10 == 0:
                true = swing(times_s[index:index + 1] - delay_s, amplitude_rad)[0]
                q = (Rotation.from_rotvec(true) * Rotation.from_rotvec(
                    SIGMA_RAD * rng.standard_normal(3))).as_quat()
                message = cdr.imu(stamp_ns, 'camera', q, (np.eye(3) * SIGMA_RAD ** 2).ravel())
                writer.write('/frame_attitude', message, stamp_ns, stamp_ns)


@pytest.mark.parametrize('delay_s', [0.0, 0.012, -0.03])
def test_a_delay_is_found(check, tmp_path, delay_s):
    write(tmp_path / 'bag', delay_s, 0.1)
    delay_ms, sigma_ms = found_ms(check(tmp_path / 'bag', '/frame_attitude', '/imu'))
    assert sigma_ms < 1 and abs(delay_ms - delay_s * 1e3) < 5 * sigma_ms


def test_without_a_motion_it_is_not_determined(check, tmp_path):
    write(tmp_path / 'bag', 0.012, 0.0)
    with pytest.raises(SystemExit, match='^not determined'):
        check(tmp_path / 'bag', '/frame_attitude', '/imu')


def test_the_golden_slew_has_none():
    """Run as a user runs it."""
    done = subprocess.run([sys.executable, str(EXAMPLE), str(ROOT / 'bags' / 'slew')],
                          capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    delay_ms, sigma_ms = found_ms(done.stdout)
    assert abs(delay_ms) < 5 * sigma_ms
