# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The types of the binding are those of the C header, its options those of the package."""

import ctypes
import re
import subprocess

from limits import HANGS_S
from native_core import compiler, kernels, ROOT
from native_extraction import config_of, NativeTracker
import numpy as np
import pytest
from startracker_ros.core import native
from startracker_ros.core.native import NativeError
from startracker_ros.core.stages.parameters import StarTrackerOptions

INCLUDES = 'startracker.h', 'startracker_ground.h', 'startracker_fusion.h', 'startracker_sim.h'
INCLUDE = ''.join(f'#include "{name}"\n' for name in INCLUDES)
FLIGHT, *MORE = ((ROOT / 'native' / 'include' / name).read_text() for name in INCLUDES)
HEADER = FLIGHT + ''.join(MORE)
DECLARED = re.compile(r'ST_API [\w *]+?\b(st_\w+)\(')
C_TYPES = {'f4': 'float', 'f8': 'double', 'i4': 'int32_t', 'u4': 'uint32_t', 'i8': 'int64_t',
           'u8': 'uint64_t'}
NAMES = {id(kind): name for name, kind in native.STRUCTS.items()}


def assertions():
    """Yield C that fails to compile where a field of the header is not that of the binding."""
    for struct, kind in native.STRUCTS.items():
        yield f'_Static_assert(sizeof({struct}) == {kind.itemsize}, "size of {struct}");'
        for field, (of_field, offset, *_) in kind.fields.items():
            where = f'{struct}.{field}'
            yield f'_Static_assert(offsetof({struct}, {field}) == {offset}, "place of {where}");'
            element, shape = of_field.subdtype or (of_field, ())
            name = NAMES.get(id(element)) or C_TYPES[element.str[1:]]
            array = ''.join(f'[{length}]' for length in shape)
            pointer = ''.join(f', const {kind} **: 1' for kind in (
                'void', 'char', 'double', 'float', 'int32_t', 'uint8_t') if name == 'uint64_t')
            yield (f'_Static_assert(_Generic(&(({struct} *)0)->{field}, {name} (*){array}: 1'
                   f'{pointer}, default: 0), "type of {where}");')


def test_each_field_of_the_binding_is_that_of_the_header(tmp_path):
    source = tmp_path / 'layout.c'
    source.write_text('\n'.join([INCLUDE, *assertions()]))
    compile_alone(source, 'c', '-std=c11')
    assert set(native.STRUCTS) == set(re.findall(r'^} (st_\w+);', HEADER, re.M)) - set(
        re.findall(r'^typedef enum {.*?} (st_\w+);', HEADER, re.M | re.S))


def compile_alone(source, language, *options):
    done = subprocess.run(
        [*compiler().command, '-x', language, *options, '-Wall', '-Wextra', '-pedantic', '-Werror',
         '-c', '-I', str(ROOT / 'native' / 'include'), str(source), '-o', f'{source}.o'],
        capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('language, standard', [('c', 'c99'), ('c++', 'c++11')])
def test_the_header_stands_alone(tmp_path, language, standard):
    """In the languages of flight software, older than those the core is written in."""
    source = tmp_path / 'alone'
    source.write_text(f'{INCLUDE}st_result result;\nst_abi abi = ST_ABI;\n'
                      'st_fused fused;\n')
    compile_alone(source, language, f'-std={standard}')


def test_functions_are_those_of_the_header():
    assert set(DECLARED.findall(HEADER)) == set(native.FUNCTIONS)


def test_the_library_names_compiler_and_processor():
    version = compiler().text.split()[-1]
    assert version.partition('-')[0] in kernels().st_build_text().decode()
    assert f'interface {native.VERSION}' in native.build_text()


def test_a_library_of_another_version_is_refused(monkeypatch):
    monkeypatch.setattr(native, 'VERSION', native.VERSION + 1)
    with pytest.raises(NativeError, match='libstartracker.so: .*different versions of startra'):
        native.library.__wrapped__()


def test_structs_of_another_size_are_refused(monkeypatch):
    monkeypatch.setitem(native.STRUCTS, 'st_result', native.HINT)
    with pytest.raises(NativeError, match='different versions'):
        native.library.__wrapped__()


@pytest.mark.parametrize('content, reason', [
    (None, 'is missing: install the package again'),
    (b'', 'is not a library of this version and machine'),
    (b'\x7fELF', 'is not a library of this version and machine')])
def test_what_is_not_a_library_is_refused(tmp_path, content, reason):
    path = tmp_path / 'libstartracker.so'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(NativeError, match=reason) as error:
        native.library.__wrapped__(path)
    assert '\n' not in str(error.value)


def test_a_library_without_the_functions_is_refused(tmp_path):
    path = tmp_path / 'libstartracker.so'
    source = tmp_path / 'other.c'
    source.write_text('int other(void) { return 1; }\n')
    subprocess.run([*compiler().command, '-x', 'c', '-shared', '-fPIC', str(source), '-o',
                    str(path)], check=True, timeout=HANGS_S)
    with pytest.raises(NativeError, match='undefined symbol: st_check_abi'):
        native.library.__wrapped__(path)


# --- options ---

# Of papers, which stay in Python; what the sky file has; a limit of time that is one of work.
ELSEWHERE = {'identification': {'method', 'magnitude_limit', 'time_limit_s'}}
PARTS = {'extraction': ('extraction', 'search'), 'identification': ('identification', 'check'),
         'tracking': ('tracker',), 'gyro': ('gyro',), 'trust': ('validation', 'protection')}
# In the order of the enumerations.
CHOICES = {'method': ('gaussian', 'binary', 'grey', 'squared', 'thresholded')}
OTHER_NAMES = {'readout_direction': 'readout_up'}
BY_TIME = {'time_limit_s': 'most_work_s'}
OF_THE_CALLER = {'slice_s'}  # of a frame that may not take long


def rows():
    """Yield part, name and option of each option that both have."""
    options = StarTrackerOptions()
    for part, stages in PARTS.items():
        for stage in stages:
            for row in type(getattr(options, stage)).table():
                if row.name not in ELSEWHERE.get(stage, ()):
                    yield part, OTHER_NAMES.get(row.name, row.name), row
                elif row.name in BY_TIME:
                    yield part, BY_TIME[row.name], row


ROWS = list(rows())


def test_every_option_has_its_place():
    config = native.defaults()
    for part in PARTS:
        assert ({name for own, name, _ in ROWS if own == part}
                == set(config.dtype[part].names) - {'reserved', *OF_THE_CALLER})


@pytest.mark.parametrize('part, name, row', ROWS, ids=[f'{part}.{name}' for part, name, _ in ROWS])
def test_default_and_range_are_those_of_the_package(part, name, row):
    default, low, high = row.default, row.low, row.high
    if row.choices:
        choices = CHOICES.get(name, row.choices)
        assert set(choices) == set(row.choices)
        default, low, high = choices.index(default), 0, len(choices) - 1
    if isinstance(default, bool):
        low, high = 0, 1
    assert native.defaults()[part][name] == default
    for bound, beyond in ((low, -1), (high, 1)):
        config, fault = native.defaults(), np.zeros((), native.FAULT)
        config[part][name] = bound
        assert native.library().st_check_config(config.ctypes.data, fault.ctypes.data) == 0
        config[part][name] = bound + beyond if row.choices or isinstance(
            row.default, int) else np.nextafter(bound, beyond * np.inf)
        status = native.library().st_check_config(config.ctypes.data, fault.ctypes.data)
        with pytest.raises(NativeError, match=f'{part}.{name} = .* out of its range'):
            native.check(status, fault)
        assert (fault['least'], fault['most']) == (low, high)


def test_options_that_may_change_are_those_that_are_live():
    tracker, fault = NativeTracker((20, 30)), np.zeros((), native.FAULT)
    for part, name, row in ROWS:
        config = config_of()
        is_least = config[part][name] == (row.low or 0)
        config[part][name] = config[part][name] + 1 if row.choices or is_least else row.low or 0
        status = kernels().st_change_options(tracker.handle, config.ctypes.data,
                                             fault.ctypes.data)
        if row.live:
            assert status == 0, name
        else:
            with pytest.raises(NativeError, match=f'{part}.{name} = .* only st_create takes'):
                native.check(status, fault)


def test_a_call_without_memory_is_refused():
    assert native.library().st_check_config(ctypes.c_void_p(), ctypes.c_void_p()) == 1
    with pytest.raises(NativeError, match='a pointer is null'):
        native.check(1)
