# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the machine code is kept: by content, shared, and somewhere even without a home."""

import json
import os
from pathlib import Path
import shutil
import subprocess
import sys

from limits import HANGS_S
import pytest
import startracker_ros
from startracker_ros.core import compiled_types
from startracker_ros.core.compiled import compiled
from startracker_ros.core.machine_code import registered_modules, signatures
from startracker_ros.core.machine_code_cache import COMPILATIONS, FUNCTIONS

PROGRAM = """
from startracker_ros.core.machine_code import code_name, machine_code_folder
from startracker_ros.core.machine_code_cache import COMPILATIONS
compiled = []
COMPILATIONS.listeners.append(lambda name, done, count: compiled.append(name))
from startracker_ros.core.camera.lens import Lens, undistort
print(undistort(Lens(9, 9, 1., 1., 4., 4., (0.,) * 9, False, False, float('inf')), 0.25, 0.5))
print(machine_code_folder())
print(code_name('startracker_ros.core.camera.lens'))
print(len([name for name in compiled if name.endswith('undistort')]))
"""
# Forks processes for PROGRAM: numba, which none of them changes, is imported and has compiled.
SERVER = """
import json, os, sys, traceback
from numba import njit
njit('float64(float64)')(lambda x: x)
for line in sys.stdin:
    program, folder, output, environment = json.loads(line)
    pid = os.fork()
    if pid == 0:
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        sys.path[0] = folder
        code = 1
        try:
            exec(program, {'__name__': '__main__'})
            code = 0
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        os._exit(code)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""
NAME = 'startracker_ros.core.camera.lens.undistort'
FILES = ('__init__.py', 'warm_up.py', *(f'core/{name}.py' for name in (
    '__init__', 'compilation', 'compiled', 'compiled_types', 'machine_code', 'machine_code_cache',
    'ctrl_c', 'extras', 'folders', 'camera/__init__', 'camera/lens', 'camera/distortion',
    'maths/__init__', 'maths/rotation')))


def copy_of(tree):
    """Return a copy of what the compiled lens needs, in which nothing is registered."""
    source = Path(startracker_ros.__file__).parent
    copy = tree / 'startracker_ros'
    for folder in ('camera', 'maths'):
        (copy / 'core' / folder).mkdir(parents=True)
    for name in FILES:
        # As pip does, which gives files the time of the build.
        shutil.copyfile(source / name, copy / name)
    return copy


@pytest.fixture
def package(tmp_path):
    return copy_of(tmp_path / 'tree')


def environment_of(package=None, home='', **variables):
    clean = {name: value for name, value in os.environ.items() if name not in (
        'XDG_CACHE_HOME', 'NUMBA_CACHE_DIR', 'STARTRACKER_COMPILED_LOG', 'PYTHONPATH')}
    own = {'HOME': str(home), 'PYTHONPATH': str(package.parent)} if package else {}
    return {**clean, **own, **variables}


@pytest.fixture(scope='module')
def server():
    with subprocess.Popen([sys.executable, '-c', SERVER], text=True, stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, env=environment_of()) as process:
        yield process


@pytest.fixture
def run(server, tmp_path):
    def run_lens(package, home, **environment):
        """Run the lens in a process; return folder and name of its code, and its compilations."""
        output = tmp_path / 'output'
        output.unlink(missing_ok=True)
        print(json.dumps([PROGRAM, str(package.parent), str(output),
                          environment_of(package, home, **environment)]),
              file=server.stdin, flush=True)
        assert server.stdout.readline() == '0\n', output.read_text()
        result, folder, name, compiles = output.read_text().splitlines()
        assert result == '(0.25, 0.5)'
        return Path(folder), name, int(compiles)
    return run_lens


def register(package):
    """Register the call of PROGRAM."""
    lens = {'named': 'startracker_ros.core.camera.lens:Lens', 'of': [
        'int64', 'int64', *['float64'] * 4, ['float64'] * 9, 'bool', 'bool', 'float64']}
    (package / 'signatures.json').write_text(json.dumps({NAME: [[lens, 'float64', 'float64']]}))


def test_equal_sources_share_their_code_and_changed_ones_do_not(run, package, tmp_path):
    folder, name, compiles = run(package, tmp_path)
    assert folder == tmp_path / '.cache' / 'startracker_ros' / 'compiled_code'
    assert compiles == 1 and [file.name for file in folder.glob(f'{name}.*')]
    other = copy_of(tmp_path / 'other')
    assert run(other, tmp_path) == (folder, name, 0)
    # What decides where code is kept does not change it.
    with (other / 'core' / 'machine_code.py').open('a') as file:
        file.write('\n# changed\n')
    assert run(other, tmp_path) == (folder, name, 0)
    # A function that the compiled one calls, in another module.
    with (other / 'core' / 'camera' / 'distortion.py').open('a') as file:
        file.write('\n# changed\n')
    _, changed, compiles = run(other, tmp_path)
    assert compiles and changed != name


def test_code_of_the_install_is_read_and_what_it_lacks_is_kept_with_the_user(
        run, package, tmp_path):
    folder = run(package, tmp_path / 'builder')[0]
    shutil.copytree(folder, package / 'compiled_code')
    found, _, compiles = run(package, tmp_path / 'user')
    assert not compiles and found.is_relative_to(tmp_path / 'user')
    assert list(found.iterdir()) == []
    # Nor does a cache that cannot be written stop a node.
    (tmp_path / 'file').write_text('')
    assert not run(package, tmp_path / 'file')[2]


def test_a_user_whose_cache_cannot_be_written_has_the_code_in_the_package(run, package, tmp_path):
    # A file where the folder should be stops root, too.
    (tmp_path / 'file').write_text('')
    folder, _, _ = run(package, tmp_path / 'file')
    assert folder == package / 'compiled_code' and not run(package, tmp_path / 'file')[2]


def test_without_any_folder_it_still_runs(run, package, tmp_path):
    (package / 'compiled_code').write_text('')
    (tmp_path / 'file').write_text('')
    nowhere = str(tmp_path / 'file')
    assert run(package, nowhere, TMPDIR='/dev/shm')[0].is_relative_to('/dev/shm')
    assert run(package, nowhere, NUMBA_CACHE_DIR=nowhere)[0] == Path('')


def test_the_choice_of_the_user_stays(run, package, tmp_path):
    chosen = tmp_path / 'mine'
    assert run(package, tmp_path, NUMBA_CACHE_DIR=str(chosen))[0] == chosen
    assert list(chosen.glob('*.code*'))


def test_registered_functions_are_compiled_beforehand(run, package, tmp_path):
    register(package)
    command = [sys.executable, '-m', 'startracker_ros.warm_up']
    done = subprocess.run(command, capture_output=True, text=True, cwd=package.parent,
                          timeout=HANGS_S, env=environment_of(package, tmp_path))
    assert done.returncode == 0 and '1 functions' in done.stderr, done.stderr
    folder, name, compiles = run(package, tmp_path)
    assert not compiles and (folder / name).is_file()


def test_the_first_call_compiles_all_that_is_registered_in_another_process(run, package, tmp_path):
    register(package)
    folder, name, compiles = run(package, tmp_path)
    # The report is of the process that compiles; this one has loaded the code.
    assert compiles == 1 and [file.name for file in folder.glob('*.code*')] == [name]
    assert not run(package, tmp_path)[2]


def test_a_damaged_file_is_not_used(run, package, tmp_path):
    folder, name, _ = run(package, tmp_path)
    file, = folder.glob(f'{name}.*')
    content = file.read_bytes()
    for damaged in (b'', content[:-9], content[:200] + b'\0' + content[201:]):
        file.write_bytes(damaged)
        assert run(package, tmp_path)[2] == 1
    assert run(package, tmp_path)[2] == 0


def test_a_process_that_is_ended_while_it_writes_leaves_nothing_half_written(
        run, package, tmp_path):
    register(package)
    folder = tmp_path / 'cache'
    process = subprocess.Popen([sys.executable, '-m', 'startracker_ros.warm_up'],
                               cwd=package.parent, stderr=subprocess.PIPE,
                               env=environment_of(package, tmp_path, NUMBA_CACHE_DIR=str(folder)))
    process.stderr.readline()
    process.kill()
    process.wait(HANGS_S)
    process.stderr.close()
    assert not run(package, tmp_path, NUMBA_CACHE_DIR=str(folder))[2] or \
        not run(package, tmp_path, NUMBA_CACHE_DIR=str(folder))[2]


def test_a_full_disk_is_named(package, tmp_path):
    register(package)
    # Every write fails with it: a folder in which files can be made, not filled.
    done = subprocess.run(
        ['bash', '-c', 'ulimit -f 1; exec "$0" -m startracker_ros.warm_up', sys.executable],
        capture_output=True, text=True, cwd=package.parent, timeout=HANGS_S,
        env=environment_of(package, tmp_path))
    assert done.returncode == 1 and 'compiled code is not complete: ' in done.stderr
    assert 'Traceback' not in done.stderr, done.stderr
    folder = tmp_path / '.cache' / 'startracker_ros' / 'compiled_code'
    assert [file for file in folder.iterdir() if file.name != 'lock'] == []


def test_all_registered_types_are_read_and_written():
    for calls in signatures().values():
        for types in calls:
            assert [compiled_types.encode(compiled_types.decode(one)) for one in types] == types
    assert registered_modules()


@compiled
def _times(value: float, factor: int) -> float:
    return factor * value


@compiled
def _five_times(value: float) -> float:
    return _times(value, 2) + _times(value, 3)


def test_a_function_is_compiled_once_for_all_constants_and_the_one_that_python_calls_reported():
    reports = []
    COMPILATIONS.listeners.append(lambda *report: reports.append(report))
    try:
        assert _five_times(3.0) == 15.0 and _five_times(4.0) == 20.0
    finally:
        COMPILATIONS.listeners.pop()
    name = f'{__name__}._five_times'
    assert reports == [(name, 0, 1), ('', 0, 0)] and name in FUNCTIONS
    assert len(_times.overloads) == 1
