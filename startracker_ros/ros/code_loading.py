# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Machine code, loaded in a thread before a node is configured."""

from collections.abc import Callable
from functools import partial
import sys
from threading import Thread

from startracker_ros.core.machine_code import machine_code_folder
from startracker_ros.ros.diagnostics import Diagnostics, WARN
from startracker_ros.ros.managed import ManagedNode
from startracker_ros.ros.memory import return_free_memory

_POLL_S = 0.02
_LOADING = 'loading code'
_CACHE = 'startracker_ros.core.machine_code_cache'


class CodeLoading:
    """
    Loads, or compiles, all registered functions of the modules that the process has imported.

    The executor stays free meanwhile, so that diagnostics continue. What is compiled, now or
    later, is reported within a second. on_loaded() is called in the executor.
    """

    def __init__(self, node: ManagedNode, diagnostics: Diagnostics,
                 warm_up: Callable[[], None], on_loaded: Callable[[], None]) -> None:
        self.is_loaded = False
        self.text = _text()
        self._node, self._diagnostics, self._on_loaded = node, diagnostics, on_loaded
        self._error: BaseException | None = None
        self._thread = Thread(target=partial(self._load, warm_up), daemon=True,
                              name=f'{node.get_name()} code')
        self._thread.start()
        self._timer = node.create_steady_timer(_POLL_S, self._check)

    @property
    def is_compiling(self) -> bool:
        """Whether code is compiled that is not there yet."""
        return not self.is_loaded and self.text != _LOADING

    @property
    def is_running(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def report(self) -> None:
        """Report that the code is loaded or compiled."""
        self._diagnostics.report(WARN, self.text, expected=True)
        self._diagnostics.publish()

    def raise_error(self) -> None:
        """Raise what the thread has raised."""
        if self._error is not None:
            raise self._error

    def _load(self, warm_up: Callable[[], None]) -> None:
        try:
            if _CACHE in sys.modules:
                from startracker_ros.core.machine_code_cache import COMPILATIONS, load_imported
                COMPILATIONS.listeners.append(self._say_compiling)
                load_imported()
            warm_up()
        except BaseException as error:
            self._error = error

    def _say_compiling(self, name: str, done: int, count: int) -> None:
        progress = f', {done} of {count} done' if count > 1 else ''
        reason = '' if self.is_loaded else f' ({self.text.removeprefix("compiling ")})'
        self._diagnostics.say_compiling(name and f'{name}{progress}{reason}')

    def _check(self) -> None:
        if not self.is_running:
            self._node.destroy_timer(self._timer)
            return_free_memory()
            self.is_loaded = True
            self._on_loaded()


def _text() -> str:
    """Return whether the code is loaded or, for the first time on a machine, compiled."""
    # Nodes without compiled functions need no numba.
    if _CACHE not in sys.modules:
        return _LOADING
    from startracker_ros.core.machine_code_cache import missing_imported
    if not missing_imported():
        return _LOADING
    if not machine_code_folder():
        return ('compiling for this machine, for a minute, at each start: no folder to keep '
                'it in can be written, set NUMBA_CACHE_DIR')
    return ('compiling for this machine, for a minute, and only once: next time '
            '`python -m startracker_ros.warm_up` does it beforehand')
