"""The subscriber of the documentation, run as a user runs it."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from limits import HANGS_S
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / 'docs' / 'examples' / 'listen_attitude.py'


def test_listener_prints_attitudes_of_running_nodes(nodes, tmp_path):
    with subprocess.Popen([sys.executable, str(EXAMPLE)], stdout=subprocess.PIPE, text=True,
                          stderr=subprocess.PIPE, env=os.environ) as listener:
        for node in ('centroid_extractor', 'star_identifier', 'star_tracker',
                     'attitude_estimator'):
            nodes.start(node)
        nodes.start('sky_simulator', {'wait_for_subscribers': 1, 'frame_rate_hz': 5.0})
        try:
            for line in listener.stdout:
                if 'no trusted attitude' not in line:
                    break
            else:
                pytest.fail('the listener ended without an attitude')
        finally:
            listener.send_signal(signal.SIGINT)
            assert listener.wait(HANGS_S) == 0
            assert listener.stderr.read() == ''
    fields = line.split()
    q = [float(fields[fields.index(name) + 1].rstrip(',')) for name in 'xyzw']
    assert sum(value * value for value in q) == pytest.approx(1, abs=1e-4)
    assert 'arcsec' in line


def test_listener_is_the_one_in_the_readme():
    assert EXAMPLE.read_text().split('"""', 2)[2].strip() in (ROOT / 'README.md').read_text()


def test_listener_is_short():
    code = [line for line in EXAMPLE.read_text().splitlines() if line.strip()]
    assert len(code) <= 22
