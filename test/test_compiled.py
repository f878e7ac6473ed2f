"""Where the machine code is kept: by content, shared, and somewhere even without a home."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest
import startracker_ros

PROGRAM = """
from startracker_ros.camera.lens import Lens, undistort
from startracker_ros.machine_code import imported_code, machine_code_folder
print(undistort(Lens(9, 9, 1., 1., 4., 4., (0.,) * 9, False, False), 0.25, 0.5))
print(machine_code_folder())
print(*sorted(imported_code()))
print(sum(undistort.stats.cache_hits.values()))
"""


def copy_of(tree):
    """Return a copy of what the compiled lens needs."""
    source = Path(startracker_ros.__file__).parent
    copy = tree / 'startracker_ros'
    (copy / 'camera').mkdir(parents=True)
    for name in ('__init__.py', 'compiled.py', 'machine_code.py', 'machine_code_cache.py',
                 'folders.py', 'camera/__init__.py', 'camera/lens.py', 'camera/distortion.py'):
        # As pip does, which gives files the time of the build.
        shutil.copyfile(source / name, copy / name)
    return copy


@pytest.fixture
def package(tmp_path):
    return copy_of(tmp_path / 'tree')


def run(package, home, **environment):
    """Run the lens in a process; return folder, names of the modules' code, and cache hits."""
    clean = {name: value for name, value in os.environ.items()
             if name not in ('XDG_CACHE_HOME', 'NUMBA_CACHE_DIR')}
    done = subprocess.run([sys.executable, '-c', PROGRAM], capture_output=True, text=True,
                          cwd=package.parent, timeout=300,
                          env={**clean, 'HOME': str(home), 'PYTHONPATH': str(package.parent),
                               **environment})
    assert done.returncode == 0, done.stderr
    result, folder, names, hits = done.stdout.splitlines()
    assert result == '(0.25, 0.5)'
    return Path(folder), names.split(), int(hits)


def test_equal_sources_share_their_code_and_changed_ones_do_not(package, tmp_path):
    folder, names, hits = run(package, tmp_path)
    assert folder == tmp_path / '.cache' / 'startracker_ros' / 'compiled_code'
    assert not hits and {file.name for file in folder.iterdir()} >= set(names)
    other = copy_of(tmp_path / 'other')
    assert run(other, tmp_path) == (folder, names, 1)
    # What decides where code is kept does not change it.
    with (other / 'machine_code.py').open('a') as file:
        file.write('\n# changed\n')
    assert run(other, tmp_path) == (folder, names, 1)
    # A function that the compiled one calls, in another module.
    with (other / 'camera' / 'distortion.py').open('a') as file:
        file.write('\n# changed\n')
    _, changed, hits = run(other, tmp_path)
    assert not hits and not set(changed) & set(names)


def test_code_of_the_build_is_read_and_what_it_lacks_is_kept_with_the_user(package, tmp_path):
    folder = run(package, tmp_path / 'builder')[0]
    shutil.copytree(folder, package / 'compiled_code')
    found, _, hits = run(package, tmp_path / 'user')
    assert hits and found.is_relative_to(tmp_path / 'user')
    assert list(found.iterdir()) == []
    # Nor does a cache that cannot be written stop a node.
    (tmp_path / 'file').write_text('')
    assert run(package, tmp_path / 'file')[2]


def test_a_user_whose_cache_cannot_be_written_has_the_code_in_the_package(package, tmp_path):
    # A file where the folder should be stops root, too.
    (tmp_path / 'file').write_text('')
    folder, _, _ = run(package, tmp_path / 'file')
    assert folder == package / 'compiled_code' and run(package, tmp_path / 'file')[2]


def test_without_any_folder_it_still_runs(package, tmp_path):
    (package / 'compiled_code').write_text('')
    (tmp_path / 'file').write_text('')
    assert run(package, tmp_path / 'file')[0] == Path('')


def test_the_choice_of_the_user_stays(package, tmp_path):
    chosen = tmp_path / 'mine'
    assert run(package, tmp_path, NUMBA_CACHE_DIR=str(chosen))[0] == chosen
    assert list(chosen.rglob('*.nbi'))
