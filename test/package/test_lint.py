"""The linters that ROS 2 packages are held to, ruff and mypy find nothing."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ('startracker_ros', 'test', 'launch', 'bags', 'docs', 'setup.py')


@pytest.mark.parametrize('linter', [
    # The order of imports and names as ament wants them; ruff has the rules of ament_pep257.
    ('ament_flake8.main', *SOURCES),
    ('ruff', 'check', '--no-cache', *SOURCES),
    ('mypy', '--no-error-summary'),
], ids=lambda words: words[0])
def test_nothing_is_found(linter):
    done = subprocess.run([sys.executable, '-m', *linter], cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True)
    found = [line for line in done.stdout.splitlines() if not line.startswith('checking ')]
    assert done.returncode == 0, '\n'.join(found)
