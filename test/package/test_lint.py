# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The linters that ROS 2 packages are held to, ruff and mypy find nothing."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import re
import subprocess
import sys
import sysconfig

from limits import HANGS_S
import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ('startracker_ros', 'evaluation/startracker_evaluation', 'test', 'launch', 'bags',
           'docs', 'native', 'setup.py')
COPYRIGHT = re.compile(r'(?:#|//) Copyright 20\d\d the startracker_ros authors\n'
                       r'(?:#|//) SPDX-License-Identifier: Apache-2\.0\n\n')


# Without the plugins whose rules ruff has (D, Q, C4, A and UP) and pycodestyle (E and W), in a
# hundredth of their time.
AMENT_FLAKE8 = """
from importlib import metadata
import sys
every = metadata.distributions
metadata.distributions = lambda: (one for one in every() if one.metadata['name'] not in (
    'flake8-docstrings', 'flake8-quotes', 'flake8-comprehensions', 'flake8-builtins',
    'flake8-deprecated'))
from ament_flake8.main import main
from flake8.checker import FileChecker
FileChecker.process_tokens = lambda self: None
sys.exit(main())
"""


@pytest.mark.parametrize('linter', [
    # The order of imports as ament wants it, and all that ruff has not.
    pytest.param(('-c', AMENT_FLAKE8, *SOURCES), marks=pytest.mark.long),
    ('-m', 'ruff', 'check', '--no-cache', *SOURCES),
    # All of pycodestyle: half of it is still a preview in ruff.
    ('-m', 'ruff', 'check', '--no-cache', '--preview', '--select', 'E,W', *SOURCES),
    pytest.param(('-m', 'mypy', '--no-error-summary'), marks=pytest.mark.long),
], ids=['ament_flake8', 'ruff', 'pycodestyle', 'mypy'])
def test_nothing_is_found(linter):
    done = subprocess.run([sys.executable, *linter], cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, timeout=HANGS_S)
    found = [line for line in done.stdout.splitlines() if not line.startswith('checking ')]
    assert done.returncode == 0, '\n'.join(found)


def test_sources_of_the_native_core_are_formatted():
    files = [path for kind in ('c', 'cpp', 'h') for path in (ROOT / 'native').rglob(f'*.{kind}')]
    done = subprocess.run(
        [Path(sysconfig.get_path('scripts'), 'clang-format'), '--dry-run', '-Werror', *files],
        stderr=subprocess.PIPE, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('checks', [
    '--checks=-clang-analyzer-*',
    # All, in ten times the time: it follows each path through a function.
    pytest.param('--checks=', marks=pytest.mark.long)], ids=['quick', 'all'])
def test_clang_tidy_finds_nothing_in_the_native_core(checks):
    clang_tidy = Path(sysconfig.get_path('scripts'), 'clang-tidy')
    options = ('-std=c++20', '-fno-exceptions', '-fno-rtti', '-Inative/include', '-Inative/src')

    def found(path):
        done = subprocess.run([clang_tidy, '--quiet', checks, path, '--', *options], cwd=ROOT,
                              capture_output=True, text=True, timeout=HANGS_S)
        return '' if done.returncode == 0 else done.stdout + done.stderr
    files = sorted((ROOT / 'native' / 'src').rglob('*.cpp'))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        assert ''.join(pool.map(found, files)) == ''


def test_every_source_begins_with_its_copyright_and_licence():
    files = [ROOT / 'setup.py', *(file for folder in SOURCES for kind in ('py', 'c', 'cpp', 'h')
                                  for file in (ROOT / folder).rglob(f'*.{kind}'))]
    assert [file for file in files if not COPYRIGHT.match(file.read_text())] == []
