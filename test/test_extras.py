# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Without a library, or with one too old, what starts works or names in a line what to install."""

import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
import tomllib

from limits import HANGS_S
import pytest
from startracker_evaluation import extras as evaluation
from startracker_ros.core import extras
from startracker_ros.core.extras import install_hint
import yaml

LIBRARIES = ('Basilisk', 'dask', 'distributed', 'jinja2', 'matplotlib', 'pyarrow')


@pytest.mark.parametrize('arguments, words, name', [
    (['bench', 'bag', '--only', 'damage', '--inputs', '50'], '', ''),
    (['export', 'bags/slew', '-o', '{out}'], '', ''),
    (['report', 'bags/slew', '-o', '{out}/report.html'],
     'The page needs Jinja2', 'report'),
    (['demo', 'closed-loop', '--output', '{out}'],
     'The closed loop needs Basilisk', 'gnc'),
    (['campaign', 'jpdaf', '--trials', '100', '--output', '{out}'],
     'A picture needs matplotlib', 'report'),
    (['campaign', 'quad', '--scheduler', 'tcp://localhost:1', '--trials', '1'],
     'A scheduler needs dask', 'scale'),
    (['export', 'bags/slew', '-o', '{out}', '--format', 'parquet'],
     'Parquet needs pyarrow', 'parquet')])
def test_a_command_without_the_extras(arguments: list[str], words: str, name: str,
                                      tmp_path: Path) -> None:
    for library in LIBRARIES:
        (tmp_path / f'{library}.py').write_text(f'raise ImportError("{library} is hidden")')
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, '-m', 'startracker_ros',
         *(word.format(out=tmp_path) for word in arguments)],
        cwd=root, env={**os.environ, 'PYTHONPATH': f'{tmp_path}{os.pathsep}{root}'},
        capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == (1 if words else 0), done.stderr
    module = evaluation if name in evaluation.libraries() else extras
    assert done.stderr.strip() == (
        f'startracker: {words}: {module.install_hint(name)}' if words else '')


def test_a_hint_is_a_command_that_works() -> None:
    """The package is on no index: libraries by name, with versions that a shell leaves alone."""
    for folder, module, optional in (('.', extras, extras.EXTRAS),
                                     ('./evaluation', evaluation, evaluation.libraries())):
        for name, libraries in optional.items():
            by_name, _, clone = module.install_hint(name).partition(', or ')
            assert shlex.split(by_name) == ['pip', 'install', *libraries]
            assert clone == f"pip install '{folder}[{name}]' in a clone of startracker_ros"
    root = Path(__file__).parents[1]
    project = tomllib.loads((root / 'evaluation' / 'pyproject.toml').read_text())['project']
    assert project['optional-dependencies'] == evaluation.libraries()
    texts = [root / 'README.md', *(root / 'docs').glob('*.md'),
             *(root / 'startracker_ros').rglob('*.py')]
    assert [path for path in texts if re.search(r'install \S?startracker_ros', path.read_text())
            ] == []


@pytest.fixture
def without_ros(tmp_path: Path) -> dict[str, str]:
    """Return an environment for this Python that has the hard dependencies, and no ROS 2."""
    installed, visible = Path(yaml.__file__).parents[1], tmp_path / 'libraries'
    visible.mkdir()
    of_ros = {path.parents[2].name for path in installed.glob('*/msg/__init__.py')}
    for path in installed.iterdir():
        if path.name not in of_ros and not path.name.startswith(('rclpy', 'ros_')):
            (visible / path.name).symlink_to(path)
    root = Path(__file__).parents[1]
    return {**os.environ, 'AMENT_PREFIX_PATH': '', 'PYTHONPATH': f'{root}{os.pathsep}{visible}'}


@pytest.mark.slow
@pytest.mark.parametrize('arguments, needs_ros', [
    (['info', '{bag}'], False), (['export', '{bag}', '-o', '{out}'], False),
    (['report', '{bag}', '-o', '{out}/report.html'], False),
    (['record'], True), (['play', '{bag}'], True), (['run', 'star_tracker'], True),
    (['demo', '--output', '{out}'], True), (['live'], True)])
def test_without_ros(arguments: list[str], needs_ros: bool, without_ros: dict[str, str],
                     tmp_path: Path) -> None:
    words = [word.format(bag=Path(__file__).parents[1] / 'bags' / 'slew', out=tmp_path)
             for word in arguments]
    # Without the site-packages, where ROS 2 is.
    base = Path(sys._base_executable)
    done = subprocess.run([base, '-m', 'startracker_ros', *words], cwd=tmp_path, env=without_ros,
                          capture_output=True, text=True, timeout=HANGS_S)
    words = (r'startracker: this needs ROS 2, and \w+ is not installed: source the setup file of '
             rf'ROS 2, or {re.escape(install_hint("ros"))}')
    assert re.fullmatch(words if needs_ros else '', done.stderr.strip())
    assert done.returncode == (1 if needs_ros else 0)
    if arguments[0] == 'export':
        # Those of every frame with an attitude.
        assert len((tmp_path / 'attitude.csv').read_text().splitlines()) == 59
    if arguments[0] == 'report':
        assert '96.67 %' in done.stdout
