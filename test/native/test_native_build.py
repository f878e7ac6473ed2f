# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What can go wrong in a build is said in a line, and leaves no half of a library."""

from pathlib import Path
import subprocess
import sys

from limits import HANGS_S
from native_core import build_module, compiler, ROOT
import pytest

BUILD = ROOT / 'native' / 'build.py'


def failure(tmp_path: Path, cxx: Path | str, output: Path | None = None) -> str:
    """Return the line of a build that fails."""
    output = output or tmp_path / 'out' / 'libstartracker.so'
    done = subprocess.run(
        [sys.executable, BUILD, '-o', output, '--objects', tmp_path / 'objects'],
        env={'PATH': '/usr/bin:/bin', 'CXX': str(cxx)}, capture_output=True, text=True,
        timeout=HANGS_S)
    assert done.returncode == 1 and not output.is_file()
    line, = done.stderr.splitlines()
    return line


def compiler_that(tmp_path: Path, does: str) -> Path:
    """Return a compiler that says its version, and compiles by a line of sh."""
    path = tmp_path / 'g++'
    path.write_text('#!/bin/sh\ncase "$1" in --version) echo "g++ 4.8.5"; exit;; -dumpmachine) '
                    f'echo x86_64-linux-gnu; exit;; esac\n{does}\n')
    path.chmod(0o755)
    return path


def test_a_compiler_that_is_not_there(tmp_path):
    assert failure(tmp_path, '/no/such/g++ -v') == (
        'native core: CXX=/no/such/g++ -v: there is no such compiler')


def test_a_program_that_is_not_a_compiler(tmp_path):
    assert failure(tmp_path, 'false').startswith('native core: false is not a compiler for C++: ')


def test_a_compiler_that_is_too_old(tmp_path):
    cxx = compiler_that(tmp_path, 'echo "In file included:" >&2; echo "g++: error: unrecognized '
                        'command line option -std=c++20" >&2; exit 1')
    assert failure(tmp_path, cxx) == (
        'native core: g++ 4.8.5 fails: g++: error: unrecognized command line option -std=c++20 '
        '(g++ 9, clang++ 11 or ziglang 0.12 or later are needed)')
    assert list((tmp_path / 'objects').iterdir()) == []


def test_a_full_disk(tmp_path):
    cxx = compiler_that(tmp_path, 'echo "fatal error: error writing to /tmp/x.s: No space left on '
                        'device" >&2; exit 1')
    assert 'No space left on device' in failure(tmp_path, cxx)


def test_a_compiler_that_writes_nothing(tmp_path):
    assert 'fails: no message' in failure(tmp_path, compiler_that(tmp_path, 'exit 0'))


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / 'file').touch()
    line = failure(tmp_path, ' '.join(compiler().command), tmp_path / 'file' / 'libstartracker.so')
    assert line.startswith(f'native core: {tmp_path}/file')


def test_a_machine_without_a_compiler(monkeypatch):
    module = build_module()
    monkeypatch.setattr(module, 'find_spec', lambda name: None)
    with pytest.raises(module.NoCompilerError, match='install g.. or clang.., or pip install zig'):
        module.find_compiler({'PATH': '/nonexistent'})


def test_the_wheel_of_zig_is_used_where_there_is_nothing_else(monkeypatch):
    module = build_module()
    monkeypatch.setattr(module, 'find_spec', lambda name: name == 'ziglang')
    monkeypatch.setattr(module, '_identified', tuple)
    assert module.find_compiler({'PATH': '/nonexistent'}) == (
        sys.executable, '-m', 'ziglang', 'c++')
