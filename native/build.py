# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Build the native core: libstartracker.so by g++, clang++ or the ziglang wheel.

python native/build.py writes it into the package, for a checkout that is not installed. setup.py
and the tests call build(). Nothing but the standard library of Python is needed.
"""

from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
from hashlib import sha256
from importlib.util import find_spec
import os
from pathlib import Path
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

NATIVE = Path(__file__).resolve().parent
LIBRARY = Path('startracker_ros', 'core', 'libstartracker.so')
"""In the package, next to native.py, which loads it."""

# Contraction would change bits from one processor to the next.
_FLAGS = ('-O3', '-fPIC', '-fvisibility=hidden', '-ffp-contract=off', '-fno-math-errno', '-Wall',
          '-Wextra', '-Wconversion', '-Wshadow', '-I', f'{NATIVE}/include', '-I', f'{NATIVE}/src')
_OF_SUFFIX = {'.c': ('-x', 'c', '-std=c11', '-D_GNU_SOURCE'),
              '.cpp': ('-std=c++2a', '-fno-exceptions', '-fno-rtti')}
# For developers: a later compiler may warn of more, which must not stop an install.
_DEVELOPED = ('-Werror', '-g', '-DST_NO_CLONES')
_SANITIZERS = ('-fsanitize=address,undefined', '-fno-sanitize-recover=all')
# The wheel of zig brings no runtime of AddressSanitizer: undefined behaviour ends the program.
_TRAPS = ('-fsanitize=undefined', '-fsanitize-trap=undefined')
# Without libstdc++ and libc++, of which nothing is needed: the library fits next to any other, and
# zig need not compile libc++, 80 s of a processor. g++ knows -nostdlib++ from version 13 on.
_LINKED = {'g++': ('-nodefaultlibs', '-lm', '-lc', '-lgcc'), 'clang++': ('-nostdlib++', '-lm'),
           'zig': ('-nostdlib++', '-lm')}
# The oldest processors that ROS 2 and NumPy run on: x86-64-v2, which g++ 9 knows by its first one.
_PROCESSOR = {'x86_64': (('-march=nehalem', '-mtune=generic'), ('-mcpu=x86_64_v2',)),
              'aarch64': (('-march=armv8-a',), ('-mcpu=generic',))}
# What is missing is an error here, not when a process loads the library.
_SHARED = ('-shared', '-Wl,-z,defs')
_FIRST_COMPILERS = 'g++ 9, clang++ 11 or ziglang 0.12'


class BuildError(RuntimeError):
    """The library cannot be built; the text says why and what to do, in a line."""


class NoCompilerError(BuildError):
    """No compiler is installed, and none is named."""


class Compiler(NamedTuple):
    """A compiler: kind is g++, clang++ or zig; text is its name with its version."""

    command: tuple[str, ...]
    kind: str
    text: str
    processor: tuple[str, ...]


class Program(NamedTuple):
    """What is built: sources, flags of compiler and linker."""

    sources: tuple[Path, ...]
    linked: tuple[str, ...]
    flags: tuple[str, ...] = ()


# --- what there is to build ---


def _core() -> tuple[Path, ...]:
    return tuple(sorted(NATIVE.glob('src/**/*.cpp')))


def library(compiler: Compiler) -> Program:
    """Return the library that is installed."""
    return Program(_core(), (*_SHARED, '-s', *_LINKED[compiler.kind]))


def _kernels() -> tuple[Path, ...]:
    return tuple(sorted(NATIVE.glob('test/kernels*.cpp')))


def library_for_tests(compiler: Compiler) -> Program:
    """Return the library with the functions of test/kernels*.h."""
    return Program((*_core(), *_kernels()), (*_SHARED, *_LINKED[compiler.kind]))


def runner(name: str, compiler: Compiler, *, sanitized: bool = False) -> Program:
    """Return a program of the tests, test/NAME.c, with or without sanitizers."""
    sources = (*_core(), *_kernels(), *(NATIVE / 'test' / file for file in (
        f'{name}.c', 'json.c', 'sky_file.c')))
    if not sanitized:
        return Program(sources, _LINKED[compiler.kind])
    if compiler.kind == 'zig':
        return Program(sources, (*_TRAPS, *_LINKED['zig']), (*_DEVELOPED, *_TRAPS))
    return Program(sources, (*_SANITIZERS, '-lm'), (*_DEVELOPED, *_SANITIZERS))


# --- compilers ---


def find_compiler(environ: Mapping[str, str] = os.environ) -> Compiler:
    """Return $CXX, else g++, clang++ or the ziglang wheel; NoCompilerError where none is there."""
    if environ.get('CXX'):
        command = shlex.split(environ['CXX'])
        if shutil.which(command[0], path=environ.get('PATH')) is None:
            raise BuildError(f'CXX={environ["CXX"]}: there is no such compiler')
        return _identified(command)
    for name in ('g++', 'clang++'):
        found = shutil.which(name, path=environ.get('PATH'))
        if found:
            return _identified([found])
    if find_spec('ziglang') is not None:
        return _identified([sys.executable, '-m', 'ziglang', 'c++'])
    raise NoCompilerError('no C++ compiler: install g++ or clang++, or pip install ziglang into '
                          f'{sys.prefix}, or set CXX')


def _identified(command: Sequence[str]) -> Compiler:
    """Return a compiler by what it says of itself."""
    of_zig = 'ziglang' in command or Path(command[0]).name == 'zig'
    done = _run([*command, '--version'])
    text = done.stdout.partition('\n')[0]
    # Of zig the name of the target may have a version that -dumpmachine does not know.
    machine = (command[command.index('-target') + 1] if '-target' in command
               else _run([*command, '-dumpmachine']).stdout)
    if done.returncode != 0 or not machine:
        raise BuildError(f'{shlex.join(command)} is not a compiler for C++: '
                         f'{_first_error(done.stdout + done.stderr)}')
    march, mcpu = _PROCESSOR.get(machine.partition('-')[0], ((), ()))
    kind = 'zig' if of_zig else 'clang++' if 'clang' in text else 'g++'
    return Compiler(tuple(command), kind, f'zig c++, {text}' if of_zig else text,
                    mcpu if of_zig else march)


# --- the build ---


def build(program: Program, target: Path, objects: Path, compiler: Compiler) -> str:
    """
    Build a program or library at a path; return a line that says so.

    Object files stay in a folder, by what made them. BuildError in a line.
    """
    begin_s = time.monotonic()
    try:
        for folder in (target.parent, objects):
            folder.mkdir(parents=True, exist_ok=True)
        # The caches of zig are in the home folder, which may be read-only or nobody's.
        environment = {**os.environ, 'LC_ALL': 'C', **dict.fromkeys(
            ('ZIG_GLOBAL_CACHE_DIR', 'ZIG_LOCAL_CACHE_DIR'), str(objects.resolve() / 'zig'))}
        parts, compiled = _compiled(program, objects, compiler, environment)
        _replace(target, [*compiler.command, *map(str, parts), *program.linked], compiler,
                 environment)
    except OSError as error:
        raise BuildError(f'{error.filename or target}: {error.strerror}') from error
    return (f'native core: {target.name}, {compiled} of {len(parts)} files compiled, '
            f'{time.monotonic() - begin_s:.1f} s, {compiler.text}')


def _compiled(program: Program, objects: Path, compiler: Compiler,
              environment: Mapping[str, str]) -> tuple[list[Path], int]:
    """Return the object files, and how many of them were compiled now."""
    headers = b''.join(path.read_bytes() for path in sorted(NATIVE.glob('**/*.h')))
    parts, missing = [], {}
    for source in program.sources:
        command = [*compiler.command, *compiler.processor, *_FLAGS, *program.flags,
                   *_OF_SUFFIX[source.suffix], '-c', str(source)]
        digest = sha256(b'\0'.join([shlex.join([compiler.text, *command]).encode(), headers,
                                    source.read_bytes()])).hexdigest()
        parts.append(objects / f'{source.stem}-{digest[:16]}.o')
        if not parts[-1].is_file():
            missing[parts[-1]] = command
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        running = [pool.submit(_replace, part, command, compiler, environment)
                   for part, command in missing.items()]
        for number, done in enumerate(as_completed(running), 1):
            done.result()
            if sys.stderr.isatty():
                print(f'\rnative core: {number} of {len(missing)} files compiled', end='\r',
                      file=sys.stderr, flush=True)
    return parts, len(missing)


def _replace(target: Path, command: Sequence[str], compiler: Compiler,
             environment: Mapping[str, str]) -> None:
    """Run a compiler that writes a file, complete or not at all."""
    # In the same folder, so that it can be renamed.
    with tempfile.NamedTemporaryFile(dir=target.parent, prefix=target.stem, delete=False) as file:
        written = Path(file.name)
    try:
        done = _run([*command, '-o', str(written)], environment)
        if done.returncode != 0 or not written.stat().st_size:
            raise BuildError(f'{compiler.text} fails: {_first_error(done.stderr)} '
                             f'({_FIRST_COMPILERS} or later are needed)')
        written.chmod(0o755)
        written.replace(target)
    finally:
        written.unlink(missing_ok=True)


def _run(command: Sequence[str], environment: Mapping[str, str] | None = None
         ) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, text=True,
                              capture_output=True)
    except OSError as error:
        raise BuildError(f'{command[0]} does not run: {error.strerror}') from error


def _first_error(text: str) -> str:
    """Return the first line of what a compiler printed that tells an error."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if 'rror' in line or 'No space' in line),
                lines[0] if lines else 'no message')


def main() -> None:
    """Build the library into the package of this checkout, or find the compiler."""
    parser = ArgumentParser(description=__doc__.strip().partition('\n')[0])
    parser.add_argument('-o', '--output', type=Path, default=NATIVE.parent / LIBRARY,
                        help='default: %(default)s')
    parser.add_argument('--objects', type=Path, default=NATIVE.parent / 'build' / 'native',
                        help='folder of object files, default: %(default)s')
    parser.add_argument('--find', action='store_true', help='print the compiler, build nothing')
    options = parser.parse_args()
    try:
        compiler = find_compiler()
        if options.find:
            print(compiler.text)
        else:
            print(build(library(compiler), options.output, options.objects, compiler))
    except BuildError as error:
        sys.exit(f'native core: {error}')


if __name__ == '__main__':
    main()
