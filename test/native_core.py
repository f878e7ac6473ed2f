# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core for tests: its build, and its inner functions by ctypes."""

import ctypes
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
from types import ModuleType

import numpy as np
from startracker_ros.core.native import FUNCTIONS

ROOT = Path(__file__).parents[1]
OBJECTS = ROOT / 'build' / 'native'


@cache
def build_module() -> ModuleType:
    """Return native/build.py."""
    spec = spec_from_file_location('native_build', ROOT / 'native' / 'build.py')
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def compiler():
    return build_module().find_compiler()


def built(program, name: str) -> Path:
    """Return the path of a program or library, built if its sources have changed."""
    target = OBJECTS / 'test' / name
    build_module().build(program, target, OBJECTS, compiler())
    return target


@cache
def kernels() -> ctypes.CDLL:
    """Return the library for tests: the functions of the header and those of test/kernels*.h."""
    library = ctypes.CDLL(str(built(build_module().library_for_tests(compiler()),
                                    'libstartracker_test.so')))
    for name, (result, arguments) in FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    header = ''.join(
        path.read_text() for path in sorted((ROOT / 'native' / 'test').glob('kernels*.h')))
    kinds = {'double': ctypes.c_double, 'int32_t': ctypes.c_int32, 'int64_t': ctypes.c_int64,
             'void': None}
    for result, name, arguments in re.findall(r'ST_API (\w+) (stt_\w+)\(([^)]*)\)', header):
        function = getattr(library, name)
        function.restype = kinds[result]
        function.argtypes = [ctypes.c_void_p if set('*[') & set(argument)
                             else kinds[argument.split()[0]] for argument in arguments.split(',')]
    return library


def filled(name: str, shape: tuple[int, ...], *arguments) -> np.ndarray:
    """Call a function whose last argument is an array of float64 that it fills; return that."""
    found = np.empty(shape)
    call(name, *arguments, found)
    return found


def call(name: str, *arguments):
    """Call a function with arrays of float64, structs and numbers."""
    given = [np.ascontiguousarray(argument) if isinstance(argument, np.ndarray) else argument
             for argument in arguments]
    return getattr(kernels(), name)(*(
        argument.ctypes.data if isinstance(argument, np.ndarray) else argument
        for argument in given))
