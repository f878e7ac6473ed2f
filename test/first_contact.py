# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
`make demo` and `make test` as a new user has them: fresh clones of the commit, an empty home.

python test/first_contact.py [--target demo|test] [--runs N] [--again N] [--loops N] [--core]

Each of the runs clones again and has a home of its own; --again repeats the target in the same
clone, where all is installed. --loops busy loops run in the same session, so that the
scheduler of Linux gives each as much as a busy process of `make`; with --core all of it is on one
core. Prints one line of JSON a run, of a failed one with the file of its output. Status 1 if one
fails.
"""

import argparse
from contextlib import ExitStack
import json
import os
from pathlib import Path
import re
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

ROOT = Path(__file__).parents[1]
LIMIT_S = 7200
# What a run leaves out: caches and settings of whoever runs this.
LEFT_OUT = {'XDG_CACHE_HOME', 'PYTHONPATH'}
FIGURES = re.compile(
    r'^│ (frames with attitude|later frames without attitude, no reason|wrong attitudes|'
    r'process start to first attitude) +│ +([\d.]+)|(\d+) passed', re.MULTILINE)


def cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run_target(target: str, clone: Path, home: Path, prefix: list[str]) -> dict[str, Any]:
    """Run a target and return what it did."""
    environment = {name: value for name, value in os.environ.items() if name not in LEFT_OUT}
    begin_s, begin_cpu_s, load = time.monotonic(), cpu_s(), os.getloadavg()[0]
    done = subprocess.run(
        [*prefix, 'make', target], cwd=clone, env={**environment, 'HOME': str(home)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=LIMIT_S)
    found = {name or 'passed': float(value or count)
             for name, value, count in FIGURES.findall(done.stdout)}
    result: dict[str, Any] = {
        'status': done.returncode, 'wall_s': round(time.monotonic() - begin_s),
        'cpu_s': round(cpu_s() - begin_cpu_s), 'load_before': load,
        'load_after': os.getloadavg()[0], **found}
    if done.returncode:
        with tempfile.NamedTemporaryFile('w', prefix='first_contact-', suffix='.log',
                                         delete=False) as file:
            file.write(done.stdout)
        result['log'] = file.name
    return result


def main() -> int:
    """Run the trials; see the top of the file."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0].strip())
    parser.add_argument('--target', choices=('demo', 'test'), default='demo')
    parser.add_argument('--runs', type=int, default=1)
    parser.add_argument('--again', type=int, default=0)
    parser.add_argument('--loops', type=int, default=0)
    parser.add_argument('--core', action='store_true')
    options = parser.parse_args()
    prefix, failed = ['taskset', '-c', '0'] if options.core else [], 0
    commit = subprocess.run(['git', 'rev-parse', '--short', 'HEAD'], cwd=ROOT, text=True,
                            capture_output=True, check=True, timeout=60).stdout.strip()
    with ExitStack() as loops:
        for _ in range(options.loops):
            loop = subprocess.Popen([*prefix, sys.executable, '-c', 'while True: pass'])
            loops.callback(loop.kill)
        for run in range(options.runs):
            with tempfile.TemporaryDirectory() as folder:
                clone, home = Path(folder, 'clone'), Path(folder, 'home')
                home.mkdir()
                subprocess.run(['git', 'clone', '-q', str(ROOT), str(clone)], check=True,
                               timeout=600)
                for again in range(options.again + 1):
                    result = run_target(options.target, clone, home, prefix)
                    failed += bool(result['status'])
                    print(json.dumps({
                        'target': options.target, 'commit': commit, 'loops': options.loops,
                        'one_core': options.core, 'run': run, 'again': again, **result}),
                        flush=True)
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
