# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What tests wait for has a limit, so that a hang is a failure with a stack trace."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RUNS = {'run', 'call', 'check_call', 'check_output'}
WAITS = {'wait', 'communicate', 'join'}


def unlimited(source: str) -> list[int]:
    """Return the lines of runs of subprocess without a timeout, and of waits without any limit."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        owner = getattr(node.func.value, 'id', '')
        is_run = owner == 'subprocess' and node.func.attr in RUNS
        names = {keyword.arg for keyword in node.keywords}
        if (is_run and not names & {'timeout', None}
                or node.func.attr in WAITS and not node.args and not names):
            lines.append(node.lineno)
    return lines


def test_each_wait_for_a_process_has_a_limit():
    found = {path.relative_to(ROOT).as_posix(): lines for path in ROOT.rglob('*.py')
             if (lines := unlimited(path.read_text()))}
    assert found == {}, 'give a timeout: HANGS_S of limits'


@pytest.mark.parametrize('source', [
    'subprocess.run([a])', 'subprocess.check_output([a], text=True)', 'process.wait()',
    'process.communicate()', 'thread.join()'])
def test_a_wait_without_a_limit_is_found(source):
    assert unlimited(source) == [1]


@pytest.mark.parametrize('source', [
    'subprocess.run([a], timeout=3)', 'subprocess.run([a], **options)', 'process.wait(HANGS_S)',
    "'x'.join(words)", 'subprocess.Popen([a])'])
def test_a_wait_with_a_limit_is_not_endless(source):
    assert unlimited(source) == []
