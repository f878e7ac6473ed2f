# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All registered functions compiled at once, by a process of their own."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
import fcntl
import os
from pathlib import Path
import subprocess
import sys
import time

from startracker_ros.core.folders import LOCK
from startracker_ros.core.machine_code import (
    calls_of, code_name, machine_code_folder, missing_modules, PACKAGE, registered_modules)

_WORKER = 'STARTRACKER_COMPILES'
# Numba tries many a signature that does not fit, and would colour the text of each such error.
_ENVIRONMENT = {_WORKER: '1', 'NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING': '1'}
_LOCK_PERIOD_S = 0.5

Report = Callable[[str, int, int], None]
"""Called with the function that is compiled now, how many of how many are done; '' at the end."""


class CompileError(RuntimeError):
    """Compiled code that cannot be made or kept; the text says why and what to do."""


def compile_missing(report: Report, folder: Path | None = None) -> None:
    """
    Compile the registered functions that have no machine code, on all cores.

    It is kept in a folder, whatever others have, by default in that of the user; without one
    nothing is done. Two processes do not compile at once. CompileError names what could not be
    kept: each process compiles that at its first call.
    """
    target = folder or Path(machine_code_folder())
    if os.environ.get(_WORKER) or not target.name:
        return
    try:
        with _lock(target, report):
            modules = missing_modules() if folder is None else [
                module for module in sorted(registered_modules())
                if not (folder / code_name(module)).exists()]
            if modules:
                _compile(modules, target, report)
    finally:
        report('', 0, 0)


def _compile(modules: Iterable[str], folder: Path, report: Report) -> None:
    names = {module: list(calls_of(module)) for module in modules}
    count, done, errors = sum(map(len, names.values())), 0, []
    command = [sys.executable, '-m', f'{PACKAGE}.warm_up', '--worker', str(folder), *names]
    worker = subprocess.Popen(
        command, env={**os.environ, **_ENVIRONMENT}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        for line in worker.stdout or ():
            if line.startswith(PACKAGE):
                report(line.strip(), done, count)
                done += 1
            else:
                errors.append(line.strip())
        if worker.wait() and not errors:
            errors.append(f'the compiling process ended with status {worker.returncode}')
    finally:
        worker.terminate()
        worker.wait()
    if errors:
        raise CompileError(f'compiled code is not complete: {errors[-1]}')


@contextmanager
def _lock(folder: Path, report: Report) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / LOCK, 'wb') as file:
        while True:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            report('in another process', 0, 0)
            time.sleep(_LOCK_PERIOD_S)
        yield


def show_progress() -> Report:
    """Return a report that draws a bar on a terminal, and prints a line elsewhere."""
    from rich.console import Console
    from rich.progress import Progress
    progress = Progress(console=Console(stderr=True), transient=True)
    task = progress.add_task('')

    def report(name: str, done: int, count: int) -> None:
        if not name:
            progress.stop()
            return
        if not progress.live.is_started:
            progress.console.print(f'compiling {count or "some"} functions for this machine: '
                                   'a minute, once')
            progress.start()
        progress.update(task, completed=done, total=count or None,
                        description=f'compiling {name.removeprefix(f"{PACKAGE}.")}')
    return report
