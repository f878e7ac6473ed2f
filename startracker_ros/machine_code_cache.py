"""
The cache of a compiled function, as numba uses it.

machine_code.py says where machine code is kept. Numba has no public way to keep it there in all
its versions: what is private of it here was tried with numba 0.68.
"""

from collections.abc import Callable
import fcntl
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import caching
from numba.core.runtime import rtsys
from startracker_ros.machine_code import code_name, folders_to_read, machine_code_folder


class _Locator(caching._CacheLocator):
    """The folder of a function's module below a root; its name is the stamp of the source."""

    root = Path()

    def __init__(self, function: Callable, file: str) -> None:
        self._name = code_name(function.__module__, Path(file))
        self._path = self.root / self._name
        self._line = function.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return str(self._path)

    def get_source_stamp(self) -> str:
        return self._name

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, function: Callable, file: str) -> '_Locator':
        return cls(function, file)


def _cache_below(root: Path) -> type:
    """Return numba's cache of a function, with its files below a root."""
    locator = type('_LocatorBelow', (_Locator,), {'root': root})
    implementation = type('_CacheBelow', (caching.CompileResultCacheImpl,), {
        '_locator_classes': [locator]})
    return type('_CodeBelow', (caching.FunctionCache,), {'_impl_class': implementation})


@cache
def _caches_to_read() -> list[type]:
    return [_cache_below(folder) for folder in folders_to_read()]


@cache
def _cache_to_write(folder: str) -> type:
    return _cache_below(Path(folder))


class MachineCodeCache(caching._Cache):
    """The machine code of a function: read from all folders, written to one."""

    def __init__(self, function: Callable) -> None:
        self._function = function
        # Many functions are never called in a process.
        self._caches: list[Any] | None = None
        code_name(function.__module__, Path(function.__code__.co_filename))

    @property
    def cache_path(self) -> str:
        return machine_code_folder()

    def load_overload(self, signature: Any, context: Any) -> Any:
        if self._caches is None:
            self._caches = [kind(self._function) for kind in _caches_to_read()]
        # Not by load_overload(), which imports all of the compiler first, for half a second: code
        # that is compiled needs the runtime only. The compiler does the same when it is called.
        rtsys.initialize(context)
        found = (cache._load_overload(signature, context) for cache in self._caches)
        return next((one for one in found if one is not None), None)

    def save_overload(self, signature: Any, result: Any) -> None:
        folder = machine_code_folder()
        if folder:
            # Two processes that save the same function could mix its files up.
            with open(Path(folder, 'lock'), 'wb') as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                _cache_to_write(folder)(self._function).save_overload(signature, result)

    def enable(self) -> None:
        """Do nothing: it is always in use."""

    def disable(self) -> None:
        """Do nothing: it is always in use."""

    def flush(self) -> None:
        """Do nothing: machine code of other sources is in other folders."""
