"""Where the machine code is kept: by content, and somewhere even if the package is read-only."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest
import startracker_ros

PROGRAM = """
from numba import config
from startracker_ros.camera.lens import Lens, undistort
print(undistort(Lens(9, 9, 1., 1., 4., 4., (0., 0., 0., 0., 0.)), 0.25, 0.5))
print(config.CACHE_DIR)
"""


@pytest.fixture
def package(tmp_path):
    """Return a copy of what the compiled lens needs."""
    source = Path(startracker_ros.__file__).parent
    copy = tmp_path / 'tree' / 'startracker_ros'
    (copy / 'camera').mkdir(parents=True)
    for name in ('__init__.py', 'compiled.py', 'machine_code.py', 'folders.py',
                 'camera/__init__.py', 'camera/lens.py', 'camera/distortion.py'):
        shutil.copy(source / name, copy / name)
    return copy


def folder_of(package, home, **environment):
    """Run the lens in a process of its own and return its folder of machine code."""
    clean = {name: value for name, value in os.environ.items()
             if name not in ('XDG_CACHE_HOME', 'NUMBA_CACHE_DIR')}
    done = subprocess.run([sys.executable, '-c', PROGRAM], capture_output=True, text=True,
                          cwd=package.parent, timeout=300,
                          env={**clean, 'HOME': str(home), 'PYTHONPATH': str(package.parent),
                               **environment})
    assert done.returncode == 0, done.stderr
    result, folder = done.stdout.splitlines()
    assert result == '(0.25, 0.5)'
    return Path(folder)


@pytest.mark.parametrize('name', ['camera/lens.py', 'camera/distortion.py', 'compiled.py'])
def test_a_changed_function_gets_a_folder_of_its_own(package, tmp_path, name):
    before = folder_of(package, tmp_path)
    assert before.parent == package / '__pycache__' and list(before.rglob('*.nbi'))
    assert folder_of(package, tmp_path) == before
    with (package / name).open('a') as file:
        file.write('\n# changed\n')
    assert folder_of(package, tmp_path) != before


def test_a_package_that_cannot_be_written_uses_the_cache_of_the_user(package, tmp_path):
    # A file where the folder should be stops root, too.
    (package / '__pycache__').write_text('')
    folder = folder_of(package, tmp_path, PYTHONDONTWRITEBYTECODE='1')
    assert folder.parent == tmp_path / '.cache' / 'startracker_ros' and list(folder.rglob('*.nbi'))


def test_without_any_folder_it_still_runs(package, tmp_path):
    (package / '__pycache__').write_text('')
    (tmp_path / 'file').write_text('')
    assert folder_of(package, tmp_path / 'file', PYTHONDONTWRITEBYTECODE='1') == Path('')


def test_the_choice_of_the_user_stays(package, tmp_path):
    assert folder_of(package, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / 'mine')) == (
        tmp_path / 'mine')
