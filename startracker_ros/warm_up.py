"""
Compile beforehand what Python calls, so that nothing is compiled once a node is ready.

python -m startracker_ros.warm_up            compile for this machine what is not there yet
python -m startracker_ros.warm_up --install  keep it in the install, for all users
python -m startracker_ros.warm_up --add LOG  register the calls of a log

signatures.json registers the calls: each function with the types of its arguments. A call with
others is compiled at its first time, and appended to the file that the environment variable
STARTRACKER_COMPILED_LOG names.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
import fcntl
from importlib import import_module
import json
import os
from pathlib import Path
from queue import Empty, Queue
import subprocess
import sys
from threading import Thread
import time
from typing import Any

from startracker_ros.machine_code import (
    code_name, INSTALLED, machine_code_folder, registered_modules, SIGNATURES, signatures)

_WORKER = 'STARTRACKER_COMPILES'
_LOCK_PERIOD_S = 0.5
_POLL_S = 0.1

Report = Callable[[str, int, int], None]
"""Called with the function that is compiled now, and how many of how many are done."""


class CompileError(RuntimeError):
    """Compiled code that cannot be made or kept; the text says why and what to do."""


def compile_missing(report: Report, folder: Path | None = None) -> None:
    """
    Compile the registered functions that have no machine code, on all cores.

    It is kept in a folder, by default that of the user; without one nothing is done. Two
    processes do not compile at once. CompileError names what could not be kept: each process
    compiles that at its first call.
    """
    if folder is None:
        folder = Path(machine_code_folder())
    if os.environ.get(_WORKER) or not folder.name:
        return
    with _lock(folder, report):
        modules = [module for module in sorted(registered_modules())
                   if not (folder / code_name(module)).exists()]
        if modules:
            _compile(modules, folder, report)


def _compile(modules: Iterable[str], folder: Path, report: Report) -> None:
    names = {module: [name for name in signatures() if name.rpartition('.')[0] == module]
             for module in modules}
    count, done, errors = sum(map(len, names.values())), 0, []
    command = [sys.executable, '-m', f'{__package__}.warm_up', '--worker', str(folder)]
    workers = [
        subprocess.Popen([*command, *share],
                         env={**os.environ, _WORKER: '1'}, stdin=subprocess.DEVNULL,
                         stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for share in _shares(names)]
    try:
        for line in _lines(workers):
            if line.startswith(__package__):
                report(line, done, count)
                done += 1
            else:
                errors.append(line)
        errors += [f'a compiling process ended with status {worker.returncode}'
                   for worker in workers if worker.wait() != 0]
    finally:
        for worker in workers:
            worker.terminate()
            worker.wait()
    if errors:
        raise CompileError(f'compiled code is not complete: {errors[-1]}')


def _lines(workers: Iterable[subprocess.Popen]) -> Iterator[str]:
    """Yield what processes print, in the order in which it comes."""
    lines: Queue[str] = Queue()
    threads = [Thread(target=_forward, args=(worker, lines), daemon=True) for worker in workers]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or not lines.empty():
        with suppress(Empty):
            yield lines.get(timeout=_POLL_S)


def _forward(worker: subprocess.Popen, lines: Queue) -> None:
    for line in worker.stdout or ():
        lines.put(line.strip())


def _shares(names: dict[str, list[str]]) -> list[list[str]]:
    """Return the modules of each worker, those of a package together: they share functions."""
    packages = defaultdict(list)
    for module in names:
        packages[module.split('.')[1]].append(module)
    shares: list[list[str]] = [[] for _ in range(min(os.cpu_count() or 1, len(packages)))]
    for package in sorted(packages.values(),
                          key=lambda package: -sum(len(names[module]) for module in package)):
        min(shares, key=lambda share: sum(len(names[module]) for module in share)).extend(package)
    return shares


@contextmanager
def _lock(folder: Path, report: Report) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / 'lock', 'wb') as file:
        while True:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            report('in another process', 0, 0)
            time.sleep(_LOCK_PERIOD_S)
        yield


def _work(folder: Path, modules: Iterable[str]) -> None:
    """Compile the registered functions of modules and write their files, printing each name."""
    from numba.core.errors import NumbaError
    from startracker_ros.compiled_types import decode
    from startracker_ros.machine_code_cache import compile_only, FUNCTIONS, key_of, save
    registered = signatures()
    names = {name for name in registered if name.rpartition('.')[0]}
    for name in sorted({name.rpartition('.')[0] for name in names}):
        import_module(name)
    compile_only(names)
    for module in modules:
        results: dict[str, Any] = {}
        for name in (name for name in registered if name.rpartition('.')[0] == module):
            print(name, flush=True)
            for types in registered[name]:
                arguments = tuple(decode(one) for one in types)
                try:
                    FUNCTIONS[name].compile(arguments)
                except (KeyError, NumbaError) as error:
                    print(f'{SIGNATURES.name}: {name}: {str(error).splitlines()[0]}', flush=True)
                    continue
                results[key_of(name, arguments)] = FUNCTIONS[name].overloads[arguments]
        save(folder / code_name(module), results)


def _add(log: Path) -> None:
    """Add the calls of a log to the registered ones, and leave out functions that are gone."""
    from startracker_ros.machine_code_cache import FUNCTIONS
    found = {name: list(types) for name, types in signatures().items()}
    for line in log.read_text().splitlines():
        name, types = json.loads(line)
        if types not in found.setdefault(name, []):
            found[name].append(types)
    for module in {name.rpartition('.')[0] for name in found}:
        with suppress(ModuleNotFoundError):
            import_module(module)
    rows = (f'{json.dumps(name)}: [\n' + ',\n'.join(
        f'  {json.dumps(one)}' for one in sorted(found[name], key=repr)) + '\n]'
        for name in sorted(found) if name in FUNCTIONS)
    SIGNATURES.write_text('{\n' + ',\n'.join(rows) + '\n}\n')


def show_progress() -> Report:
    """Return a report that draws a bar on a terminal, and prints a line elsewhere."""
    from rich.console import Console
    from rich.progress import Progress
    progress = Progress(console=Console(stderr=True), transient=True)
    task = progress.add_task('compiling for this machine, once')
    begun: list[bool] = []

    def report(name: str, done: int, count: int) -> None:
        if not begun:
            begun.append(True)
            progress.console.print(f'compiling {count or "some"} functions for this machine: '
                                   'a minute, once')
            progress.start()
        progress.update(task, completed=done, total=count or None,
                        description=f'compiling {name.removeprefix(f"{__package__}.")}')
        if count and done == count - 1:
            progress.stop()
    return report


def main(arguments: list[str] = sys.argv[1:]) -> int:
    """Compile what is missing; see the top of the file."""
    if arguments[:1] == ['--worker']:
        try:
            _work(Path(arguments[1]), arguments[2:])
        except OSError as error:
            print(f'{error.strerror}: {error.filename}', flush=True)
        return 0
    if arguments[:1] == ['--add']:
        _add(Path(arguments[1]))
        return 0
    try:
        compile_missing(show_progress(), INSTALLED if '--install' in arguments else None)
    except (CompileError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
