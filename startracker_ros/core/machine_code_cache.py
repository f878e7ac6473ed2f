# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The machine code of compiled functions: one object file a module, loaded when first used.

A module's file (machine_code.py) holds the functions that Python calls, with the types of
signatures.json, in one object: the functions that they call are in it once, as local symbols.
Numba's own cache keeps an object and the intermediate code of each function and of each that it
calls, which takes ten times the time and memory to load. What is compiled all the same, because a
type is not registered, is reported by listeners, and kept in a file of its own.

Numba has no public way to do this: what is private of it here was tried with numba 0.61 to 0.68.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
import hashlib
from importlib import import_module
import json
import os
from pathlib import Path
import pickle
import sys
from types import FrameType
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import event, serialize, sigutils
from numba.core.compiler import compile_result
from numba.core.environment import Environment, lookup_environment
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from startracker_ros.core.compilation import compile_missing, CompileError, show_progress
from startracker_ros.core.compiled_types import decode, encode
from startracker_ros.core.extras import check_numba
from startracker_ros.core.folders import limit_cache, mark_used, replaced
from startracker_ros.core.machine_code import (
    code_name, folders_to_read, machine_code_folder, missing_modules, PACKAGE, registered_modules,
    signatures)

check_numba()

FUNCTIONS: dict[str, Any] = {}
"""Every compiled function of the imported modules, by its full name."""

_ENVIRONMENT = '_ZN08NumbaEnv'
_DIGEST_BYTES = 32
_COMPILE_ONLY: list[bool] = []


class _Compilations(event.Listener):
    """
    Reports each function of this process that is compiled, not those that it calls.

    listeners are called with the name, how many of how many functions are done, and with an
    empty name at the end.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.listeners: list[Callable[[str, int, int], None]] = []

    def on_start(self, record: event.Event) -> None:
        self.depth += 1
        if self.depth == 1:
            name = full_name(record.data['dispatcher'].py_func)
            _log(name, record.data['args'])
            self.report(name, 0, 1)

    def on_end(self, record: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            self.report('', 0, 0)

    def report(self, name: str, done: int, count: int) -> None:
        """Report a compilation to all listeners."""
        for listener in self.listeners:
            listener(name, done, count)


def _log(name: str, types: Iterable[Any]) -> None:
    """Append a call of the package that is not registered to the log, where there is one."""
    log = os.environ.get('STARTRACKER_COMPILED_LOG')
    if not log or name not in FUNCTIONS or _COMPILE_ONLY:
        return
    call = [encode(one) for one in types]
    if call in signatures().get(name, []):
        return
    frame: FrameType | None = sys._getframe()
    while frame and frame.f_globals['__name__'].startswith(('numba.', 'contextlib', __name__)):
        frame = frame.f_back
    if frame and frame.f_globals['__name__'].startswith(f'{PACKAGE}.'):
        with open(log, 'a') as file:
            file.write(json.dumps([name, call]) + '\n')


COMPILATIONS = _Compilations()
event.register('numba:compile', COMPILATIONS)


class _Saved(NamedTuple):
    """A function as it is saved: what numba knows of it, and the environments of its code."""

    descriptor: Any
    signature: Any
    reload: tuple
    environments: tuple[tuple[str, list, str], ...]


class _LoadedLibrary:
    """What numba asks of the library of a loaded function: its symbols are in the engine."""

    _reload_init: frozenset = frozenset()

    def __init__(self, codegen: Any) -> None:
        self.codegen = codegen

    def _ensure_finalized(self) -> None:
        pass

    def _get_module_for_linking(self) -> llvm.ModuleRef:
        """Return an empty module: a function that calls this one is linked by its name."""
        return llvm.parse_assembly(str(self.codegen._create_empty_module('loaded')))


class _Unit:
    """A file of machine code."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        mark_used(path)
        digest, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(payload).digest() != digest:
            raise ValueError(f'{path} is damaged')
        self._saved, self._object = pickle.loads(payload)

    def load(self, key: str, context: Any) -> Any:
        """Return a function as numba has it after a compilation, None if it is not here."""
        if key not in self._saved:
            return None
        codegen = context.codegen()
        engine = codegen._engine
        if self._object is not None:
            engine._ee.add_object_file(llvm.ObjectFileRef.from_data(self._object))
            engine.finalize_object()
            self._object = None
        saved: _Saved = pickle.loads(self._saved[key])
        for initialise in saved.reload:
            initialise()
        environments = [_environment(*one) for one in saved.environments]
        for environment in environments:
            codegen.set_env(environment.env_name, environment)
        descriptor, library = saved.descriptor, _LoadedLibrary(codegen)
        address = engine.get_function_address(descriptor.llvm_cpython_wrapper_name)
        if not address:
            raise ValueError(f'{descriptor.qualname} is not in its machine code')
        # Code without constants has no environment.
        own = next((one for one in environments if one.env_name == descriptor.env_name),
                   Environment(descriptor.lookup_globals()))
        function = _dynfunc.make_function(
            descriptor.lookup_module(), descriptor.qualname, descriptor.qualname,
            address, own, (library, *environments))
        return compile_result(
            target_context=context, typing_context=cpu_target.typing_context, library=library,
            environment=own, entry_point=function, fndesc=descriptor, type_annotation='',
            signature=saved.signature, objectmode=False, lifted=(), typing_error=None,
            call_helper=None, metadata=None, reload_init=[], referenced_envs=environments)


def _environment(module: str, constants: list, name: str) -> Environment:
    environment = Environment(import_module(module).__dict__)
    environment.consts[:] = constants
    environment.env_name = name
    return environment


def full_name(function: Callable) -> str:
    return f'{function.__module__}.{function.__qualname__}'


def key_of(name: str, types: Iterable[Any]) -> str:
    """Return the key of a function and its types in a file."""
    return f'{name}{tuple(types)}'


def save(path: Path, functions: dict[str, Any]) -> None:
    """Write functions by key to a file, all or nothing; OSError where that fails."""
    codegen = cpu_target.target_context.codegen()
    library = codegen.create_library(path.stem)
    module = library._final_module
    for part in dict.fromkeys(part for result in functions.values() for part in _parts(result)):
        module.link_in(part._final_module, preserve=True)
    # Unique, since names of numba count what a process has compiled.
    suffix = f'.{hashlib.sha256(path.name.encode()).hexdigest()[:16]}'
    visible = {name for result in functions.values() for name in (
        result.fndesc.llvm_func_name, result.fndesc.llvm_cpython_wrapper_name)}
    for value in list(module.functions):
        if value.is_declaration:
            continue
        if value.name in visible:
            value.linkage = llvm.Linkage.external
            value.name += suffix
        else:
            value.linkage = llvm.Linkage.internal
    environments = [value.name for value in module.global_variables
                    if value.name.startswith(_ENVIRONMENT)]
    for name in environments:
        module.get_global_variable(name).name = name + suffix
    saved = {key: serialize.dumps(_saved(result, environments, suffix))
             for key, result in functions.items()}
    module.verify()
    if _COMPILE_ONLY:
        library._optimize_final_module()
    payload = pickle.dumps((saved, codegen._tm.emit_object(module)))
    with replaced(path) as file:
        file.write(hashlib.sha256(payload).digest() + payload)
        file.flush()
        os.fsync(file.fileno())
    limit_cache()


def _parts(result: Any) -> list[Any]:
    """Return the libraries that hold the code of a function and of those that it calls."""
    found = [result.library]
    if _COMPILE_ONLY:
        for library in found:
            found += [one for one in dict.fromkeys(library._linking_libraries)
                      if one not in found]
    return found


def _needs_loaded(result: Any) -> bool:
    """Return whether a function calls one that this process has loaded, others perhaps not."""
    return any(value.is_declaration and PACKAGE in value.name
               for value in result.library._final_module.functions)


def _saved(result: Any, names: Iterable[str], suffix: str) -> _Saved:
    used = {value.name for part in _parts(result)
            for value in part._final_module.global_variables}
    found = [(name, lookup_environment(name)) for name in names if name in used]
    descriptor = result.fndesc
    descriptor.typemap = descriptor.calltypes = None
    descriptor = pickle.loads(serialize.dumps(descriptor))
    descriptor.mangled_name += suffix
    descriptor.env_name += suffix
    return _Saved(descriptor, result.signature, tuple(result.reload_init), tuple(
        (one.globals['__name__'], list(one.consts), name + suffix)
        for name, one in found if one is not None and one.can_cache()))


def _compile_missing() -> None:
    try:
        compile_missing(COMPILATIONS.report if COMPILATIONS.listeners else show_progress())
    except (CompileError, OSError) as error:
        print(error, file=sys.stderr)


def missing_imported() -> list[str]:
    """Return the imported modules with registered functions that have no machine code."""
    imported = {name.rpartition('.')[0] for name in list(FUNCTIONS)}
    return missing_modules(imported & registered_modules())


def load_imported() -> None:
    """Load, or compile, all registered functions of the modules that this process has imported."""
    registered = signatures()
    # Modules may be imported meanwhile by another thread.
    functions = {name: FUNCTIONS[name] for name in list(FUNCTIONS) if name in registered}
    if missing_imported():
        _compile_missing()
    for name, function in functions.items():
        for types in registered[name]:
            function.compile(tuple(decode(one) for one in types))


def compile_only(names: Iterable[str]) -> None:
    """
    Make this process one that compiles functions and runs none, for the files.

    names: the functions that Python calls. The others are part of them: their machine code is
    not made, nor what Python would need to call them.
    """
    _COMPILE_ONLY.append(True)
    context = cpu_target.target_context
    context.refresh()
    rtsys.initialize(context)
    # Nodes load machine code without it.
    from numba.np import arrayobj
    called = set(names)
    kind = type(context)
    make_wrapper = kind.create_cpython_wrapper

    def make_wrapper_if_called(self: Any, library: Any, descriptor: Any, *more: Any,
                               **options: Any) -> None:
        if f'{descriptor.modname}.{descriptor.qualname}' in called:
            make_wrapper(self, library, descriptor, *more, **options)

    # Options of the functions would do it, too, but for callers with other options numba compiles
    # its own functions anew.
    kind.create_cpython_wrapper = make_wrapper_if_called
    kind.create_cfunc_wrapper = lambda *_, **__: None
    # The text with both shapes in the error of a wrong assignment takes more code than the rest
    # of many a function. numba 0.61 has none.
    if hasattr(arrayobj, 'raise_with_shape_context'):
        shape_error: Any = cpu_target.typing_context.resolve_value_type(
            arrayobj.raise_with_shape_context)
        shape_error.templates = tuple(one for one in shape_error.templates
                                      if one.metadata['target'] == 'generic')

    def no_executable(library: Any, descriptor: Any, environment: Environment) -> Any:
        library.finalize()
        return _dynfunc.make_function(descriptor.lookup_module(), descriptor.qualname, '',
                                      id(context), environment, (library,))
    context.get_executable = no_executable
    codegen = context.codegen()
    codegen._add_module = lambda module: None
    codegen._library_class.finalize = _finalize


def _finalize(library: Any) -> None:
    """Leave a function as it is, and inline and optimise once, in the file that it is saved in."""
    for part in library._linking_libraries:
        # numba 0.61 has none.
        if hasattr(part, '_reload_init'):
            library._reload_init.update(part._reload_init)
    for function in library._final_module.functions:
        # Several functions may bring the same help of numba.
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.linkage = llvm.Linkage.weak_odr
    library._finalized = True


@cache
def _units(module: str) -> list[_Unit]:
    """Return what is there of a module, its registered functions first; compile what is not."""
    if module in registered_modules() and missing_modules([module]):
        _compile_missing()
    units, name = [], code_name(module)
    for folder in folders_to_read():
        for path in [folder / name, *sorted(folder.glob(f'{name}.*'))]:
            # One that is damaged or from another version is compiled anew.
            with suppress(OSError, ValueError, pickle.PickleError, EOFError, AttributeError,
                          ImportError):
                units.append(_Unit(path))
    return units


class MachineCodeCache:
    """The machine code of a function, in the place of numba's cache."""

    def __init__(self, dispatcher: Any) -> None:
        self._module, self._name = dispatcher.py_func.__module__, full_name(dispatcher.py_func)
        # Where no source of the package is its own, as in tests, nothing says when it changes.
        self._is_kept = self._module.startswith(f'{PACKAGE}.')
        FUNCTIONS[self._name] = dispatcher

    @property
    def cache_path(self) -> str:
        return machine_code_folder()

    def load_overload(self, signature: Any, context: Any) -> Any:
        if not self._is_kept:
            return None
        # A function that is compiled contains those that it calls: these are compiled with it.
        if COMPILATIONS.depth or _COMPILE_ONLY:
            return None
        rtsys.initialize(context)
        types, _ = sigutils.normalize_signature(signature)
        key = key_of(self._name, types)
        found = (unit.load(key, context) for unit in _units(self._module))
        loaded = next((one for one in found if one is not None), None)
        if loaded is not None:
            # Another process, as a test, may have compiled and kept what is not registered.
            _log(self._name, types)
        return loaded

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what was compiled because its types are not registered."""
        folder = machine_code_folder()
        if (self._is_kept and not COMPILATIONS.depth and not _COMPILE_ONLY and folder
                and not result.library.has_dynamic_globals and not _needs_loaded(result)):
            types, _ = sigutils.normalize_signature(signature)
            key = key_of(self._name, types)
            digest = hashlib.sha256(key.encode()).hexdigest()[:16]
            # Without room for it the next process compiles again.
            with suppress(OSError):
                save(Path(folder, f'{code_name(self._module)}.{digest}'), {key: result})

    def enable(self) -> None:
        """Do nothing: it is always in use."""

    def disable(self) -> None:
        """Do nothing: it is always in use."""

    def flush(self) -> None:
        """Do nothing: machine code of other sources is in other files."""
