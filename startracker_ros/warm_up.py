# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Compile beforehand what Python calls, so that nothing is compiled once a node is ready.

python -m startracker_ros.warm_up            compile for this machine what is not there yet
python -m startracker_ros.warm_up --install  keep it in the install, for all users
python -m startracker_ros.warm_up --add LOG  register the calls of a log

signatures.json registers the calls: each function with the types of its arguments. A call with
others is compiled at its first time, and appended to the file that the environment variable
STARTRACKER_COMPILED_LOG names.
"""

from collections import deque
from collections.abc import Iterable
from contextlib import suppress
import gc
from importlib import import_module
import json
from multiprocessing import get_context
import os
from pathlib import Path
import sys
from typing import Any

from numba.core.errors import NumbaError
from startracker_ros.core.compilation import compile_missing, CompileError, show_progress
from startracker_ros.core.compiled_types import decode
from startracker_ros.core.machine_code import (
    calls_of, code_name, INSTALLED, registered_modules, SIGNATURES, signatures)
from startracker_ros.core.machine_code_cache import compile_only, FUNCTIONS, key_of, save


def _work(folder: Path, modules: Iterable[str]) -> bool:
    """
    Compile the registered functions of modules, print their names, return whether files are there.

    This process translates what many modules call only once. Forked processes have all of it, and
    make the machine code of a module meanwhile.
    """
    for module in sorted(registered_modules()):
        import_module(module)
    compile_only(signatures())
    # Little of what a compilation makes is garbage before its end.
    gc.disable()
    fork, writers = get_context('fork'), deque[Any]()
    complete = True
    for module in modules:
        results: dict[str, Any] = {}
        for name, calls in calls_of(module).items():
            print(name, flush=True)
            for types in calls:
                arguments = tuple(decode(one) for one in types)
                try:
                    FUNCTIONS[name].compile(arguments)
                except (KeyError, NumbaError) as error:
                    print(f'{SIGNATURES.name}: {name}: {str(error).splitlines()[0]}', flush=True)
                    continue
                results[key_of(name, arguments)] = FUNCTIONS[name].overloads[arguments]
                # What is left is kept to the end: later collections leave it out.
                gc.collect(0)
                gc.freeze()
        if len(writers) >= (os.cpu_count() or 1):
            complete &= _ended(writers.popleft())
        writers.append(fork.Process(target=_write, args=(folder / code_name(module), results)))
        writers[-1].start()
    for writer in writers:
        complete &= _ended(writer)
    return complete


def _write(path: Path, results: dict[str, Any]) -> None:
    try:
        save(path, results)
    except OSError as error:
        print(f'{error.strerror}: {error.filename}', flush=True)


def _ended(writer: Any) -> bool:
    writer.join()
    return writer.exitcode == 0


def _add(log: Path) -> None:
    """Add the calls of a log to the registered ones, and leave out functions that are gone."""
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


def main(arguments: list[str] = sys.argv[1:]) -> int:
    """Compile what is missing; see the top of the file."""
    if arguments[:1] == ['--worker']:
        return 0 if _work(Path(arguments[1]), arguments[2:]) else 1
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
