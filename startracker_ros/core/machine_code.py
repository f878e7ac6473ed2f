# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Where the machine code of compiled functions is kept.

A module with compiled functions has a file, named by the module, by the content of its source and
of all sources of the package that it imports, directly or not, and by what it was compiled for:
a compiled function contains the functions that it calls and the constants that it uses. So equal
sources share their machine code, wherever they are installed, a change compiles what depends on
it, and code of another processor or another version of numba is never loaded. Numba is not needed
to know which file: its import takes longer than many a start.
"""

from collections.abc import Iterable
from functools import cache
import hashlib
from importlib.metadata import version
import json
import os
from pathlib import Path
import re
import sys
import tempfile

from llvmlite import binding
from startracker_ros.core.folders import cache_folder, can_write, COMPILED_CODE

PACKAGE = __name__.partition('.')[0]
_PACKAGE = Path(__file__).parents[1]
_COMPILER = 'compiled.py'

INSTALLED = _PACKAGE / COMPILED_CODE
"""Machine code in the install, made by `warm_up --install`; others only read it."""

SIGNATURES = _PACKAGE / 'signatures.json'
"""What Python calls: by function, the types of its arguments (compiled_types.py)."""

_IMPORT = re.compile(r'^from (startracker_ros[\w.]*) import (\([^)]*\)|.*)', re.MULTILINE)


@cache
def signatures() -> dict[str, list]:
    """Return the types that functions are called with, by the function's full name."""
    return json.loads(SIGNATURES.read_text()) if SIGNATURES.exists() else {}


def calls_of(module: str) -> dict[str, list]:
    """Return what is registered of one module, sorted."""
    return {name: types for name, types in sorted(signatures().items())
            if name.rpartition('.')[0] == module}


@cache
def registered_modules() -> frozenset[str]:
    """Return the modules with functions that Python calls."""
    return frozenset(name.rpartition('.')[0] for name in signatures())


@cache
def machine_code_folder() -> str:
    """Return where new machine code is kept; empty where nothing can be written."""
    return next((str(folder) for folder in _folders() if _writable(folder)), '')


def folders_to_read() -> list[Path]:
    """Return the folders that may hold machine code."""
    return [folder for folder in sorted(_folders(), key=INSTALLED.__ne__) if folder.is_dir()]


def code_name(module: str) -> str:
    """Return the name of the file with the registered functions of a module of the package."""
    return f'{_source_name(module)}-{_target()}.code'


def missing_modules(modules: Iterable[str] | None = None) -> list[str]:
    """Return the modules without machine code, of those that Python calls or of some of them."""
    return [module for module in sorted(registered_modules() if modules is None else modules)
            if not any((folder / code_name(module)).exists() for folder in folders_to_read())]


def _folders() -> list[Path]:
    """Return where machine code may be kept, the best first."""
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    if chosen:
        return [Path(chosen)]
    return [cache_folder() / COMPILED_CODE, INSTALLED,
            Path(tempfile.gettempdir(), f'startracker_ros_{os.getuid()}', COMPILED_CODE)]


@cache
def _target() -> str:
    """Return a digest of compiler, interpreter and processor."""
    features = sorted(binding.get_host_cpu_features().items())
    made_for = (version('numba'), version('llvmlite'), version('numpy').split('.')[0],
                sys.version_info[:2], binding.get_process_triple(), binding.get_host_cpu_name(),
                features)
    return hashlib.sha256(repr(made_for).encode()).hexdigest()[:8]


@cache
def digest_of_sources(file: Path) -> str:
    """Return a digest of a source and of all sources of the package that it imports."""
    return hashlib.sha256(b''.join(
        _source(source)[0] for source in sorted(_sources_of(file)))).hexdigest()


@cache
def _source_name(module: str) -> str:
    file = _PACKAGE.parent.joinpath(*module.split('.')).with_suffix('.py')
    made_of = repr((list(calls_of(module).items()), digest_of_sources(file)))
    return f'{module}-{hashlib.sha256(made_of.encode()).hexdigest()[:16]}'


def _sources_of(file: Path) -> set[Path]:
    """Return a source and all sources of the package that it imports, directly or not."""
    found, pending = set(), [file]
    while pending:
        source = pending.pop()
        if source not in found:
            found.add(source)
            # What the compiler's settings import decides where code is kept, not what it is.
            if source.name != _COMPILER:
                pending += _source(source)[1]
    return found


@cache
def _source(file: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Return the hash of a source and the sources of the package that it imports at its top."""
    content = file.read_bytes()
    found = []
    for module, names in _IMPORT.findall(content.decode()):
        path = _PACKAGE.parent.joinpath(*module.split('.'))
        members = (path / f'{name}.py' for name in re.findall(r'\w+', names))
        found += [one for one in (path.with_suffix('.py'), *members) if one.is_file()]
    return hashlib.sha256(content).digest(), tuple(found)


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    # A folder for all users may hold one that somebody else has made.
    return folder.stat().st_uid == os.getuid() and can_write(folder)
