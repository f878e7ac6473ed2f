"""
Where the machine code of compiled functions is kept.

Each module with compiled functions has a folder, named by the module and by the content of its
source and of all sources of the package that it imports, directly or not: a compiled function
contains the functions that it calls and the constants that it uses. So equal sources share their
machine code, wherever they are installed, and a change compiles what depends on it. Numba is not
needed to know which folder: its import takes longer than many a start.
"""

from collections.abc import Iterable
from functools import cache
import hashlib
import os
from pathlib import Path
import re
import shutil

from startracker_ros.folders import cache_folder, can_write

_PACKAGE = Path(__file__).parent
_COMPILER = 'compiled.py'

INSTALLED = _PACKAGE / 'compiled_code'
"""Machine code that the build has made, see setup.py; nodes only read it."""

_IMPORT = re.compile(r'^from (startracker_ros[\w.]*) import (\([^)]*\)|.*)', re.MULTILINE)

_imported: set[str] = set()


@cache
def machine_code_folder() -> str:
    """Return where new machine code is kept; empty where nothing can be written."""
    return next((str(folder) for folder in _folders() if _writable(folder)), '')


def folders_to_read() -> list[Path]:
    """Return the folders that may hold machine code."""
    return [folder for folder in sorted(_folders(), key=INSTALLED.__ne__) if folder.is_dir()]


def code_name(module: str, file: Path) -> str:
    """Return the name of the folder of a module that this process has imported."""
    name = _name(module, file)
    _imported.add(name)
    return name


def imported_code() -> set[str]:
    """Return the names of the folders of the modules that this process has imported."""
    return _imported


def package_code() -> set[str]:
    """Return the names of the folders of all modules of the package that compile functions."""
    modules = (file for file in _PACKAGE.rglob('*.py')
               if any(one.name == _COMPILER for one in _source(file)[1]))
    return {_name('.'.join((_PACKAGE.name, *file.relative_to(_PACKAGE).with_suffix('').parts)),
                  file) for file in modules}


def cached_share(names: Iterable[str]) -> float:
    """Return which share of modules has machine code."""
    found = [any((folder / name).is_dir() for folder in folders_to_read()) for name in names]
    return sum(found) / max(1, len(found))


def copy_code(target: Path) -> None:
    """Copy the machine code of all modules that this process has imported."""
    for folder in folders_to_read():
        for name in _imported:
            if (folder / name).is_dir() and folder.resolve() != target.resolve():
                shutil.copytree(folder / name, target / name, dirs_exist_ok=True)


def _folders() -> list[Path]:
    """Return where machine code may be kept, the best first."""
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    return [Path(chosen)] if chosen else [cache_folder() / 'compiled_code', INSTALLED]


@cache
def _name(module: str, file: Path) -> str:
    digest = hashlib.sha256()
    for source in sorted(_sources_of(file)):
        digest.update(_source(source)[0])
    return f'{module}-{digest.hexdigest()[:16]}'


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
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return can_write(folder)
