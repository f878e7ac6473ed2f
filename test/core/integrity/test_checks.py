# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The table of checks is used as a whole, and holds all thresholds of those who evaluate them."""

import ast
from functools import cache
from pathlib import Path
import re

from native_core import ROOT
import pytest
import startracker_ros
from startracker_ros.core.integrity.checks import CHECKS

PACKAGE, NATIVE = Path(startracker_ros.__file__).parent, ROOT / 'native' / 'src'
TABLE, MODULE = PACKAGE / 'core/integrity/checks.py', 'startracker_ros.core.integrity.checks'
FIGURES = NATIVE / 'integrity' / 'checks.h'
EVALUATE = [path for path in sorted((PACKAGE / 'core' / 'integrity').glob('*.py'))
            if path != TABLE] + [PACKAGE / 'core' / f'{name}.py' for name in (
                'stages/attitude', 'stages/tracking', 'track/track_filter')]
NATIVE_EVALUATE = [*sorted((NATIVE / 'integrity').glob('*.cpp')), *(
    NATIVE / f'{name}.cpp' for name in (
        'track/correction', 'track/attitude_model', 'track/repetition', 'track/rotation_fit',
        'track/start', 'track/track_filter'))]
# What is compared and is not the threshold of a check: more likely than not, nanoseconds, modes of
# motion, rounding errors, the share that few stars have.
OTHERS = {'0.5', '1.0', '1e-09'}
OF_FILES = {'protection': {'1e-06', '1e-300'}}
OF_NATIVE = {'expected_stars': {'LEAST_SPEED2'}, 'residual_columns': {'DEPENDENT'},
             'correction': {'0.1'}}
ORDER = ast.Lt, ast.LtE, ast.Gt, ast.GtE


@cache
def used() -> tuple[set[str], set[str]]:
    """Return what the package and the core use of the table, and the words of all texts."""
    checks, words = set(), set()
    for path in NATIVE.rglob('*.[ch]*'):
        checks |= set(re.findall(r'\w+', path.read_text())) if path != FIGURES else set()
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())) if path != TABLE else ():
            if isinstance(node, ast.ImportFrom) and node.module == MODULE:
                checks |= {alias.name for alias in node.names}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                words |= set(re.findall(r'\w+', node.value))
            elif isinstance(node, ast.Name):
                words.add(node.id)
    return checks, words


def loose_thresholds(source: str) -> set[str]:
    """Return names of figures of a module, and figures, that something is compared with."""
    tree, figures = ast.parse(source), set[str]()
    for node in tree.body:
        if isinstance(node, ast.Assign):
            inner = list(ast.walk(node.value))
            if any(isinstance(one, ast.Constant) and isinstance(one.value, int | float)
                   for one in inner) and not any(
                       isinstance(one, ast.Name) and one.id in CHECKS for one in inner):
                figures |= {one.id for target in node.targets for one in ast.walk(target)
                            if isinstance(one, ast.Name)}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ORDER):
            for one in ast.walk(node):
                if isinstance(one, ast.Name) and one.id in figures:
                    found.add(one.id)
                elif isinstance(one, ast.Constant) and isinstance(one.value, float):
                    found.add(str(one.value))
    return found


@pytest.mark.parametrize('name', CHECKS)
def test_a_check_is_used_and_what_a_user_sees_exists(name):
    check, (checks, words) = CHECKS[name], used()
    keys = set(re.findall(r'`(\w+)', check.diagnostic))
    assert keys | {*check.options.split(', ')} - {''} <= words
    # A check without figures may be the counter that shows it.
    assert name in checks or (keys and not (check.probability or check.limits or check.frames))


@pytest.mark.parametrize('path', EVALUATE, ids=lambda path: path.stem)
def test_no_threshold_stands_elsewhere(path):
    assert loose_thresholds(path.read_text()) <= OTHERS | OF_FILES.get(path.stem, set())


def loose_native_thresholds(source: str) -> set[str]:
    """Return the same of a source in C++: numbers, and constants that are numbers."""
    code = re.sub(r'//.*|"[^"\n]*"|template *<[^>]*>|<\w+>', '', source)
    number = r'-?\d+\.\d*(?:e-?\d+)?|-?\d+e-?\d+'
    figures = set(re.findall(rf'constexpr double (\w+) = (?:{number});', code))
    compared = {side for sides in re.findall(
        rf'({number}|\w+) *[<>]=? *({number}|\w+)', code) for side in sides}
    return {one for one in compared if re.fullmatch(number, one) or one in figures}


@pytest.mark.parametrize('path', NATIVE_EVALUATE, ids=lambda path: path.stem)
def test_no_threshold_stands_elsewhere_in_the_core(path):
    assert loose_native_thresholds(path.read_text()) <= OF_NATIVE.get(path.stem, set())


def test_a_threshold_elsewhere_is_found():
    native = 'constexpr double LIMIT = 36.0;\nif (x > LIMIT || y <= 1e-3 || z < 4) {}'
    assert loose_native_thresholds(native) == {'LIMIT', '1e-3'}
    assert loose_thresholds('LIMIT, NAME = 36.0, ""\nif x > LIMIT * y:\n    pass') == {'LIMIT'}
    assert loose_thresholds('LIMIT = gate(1e-3, 3)\nbad = not x <= LIMIT') == {'LIMIT'}
    assert loose_thresholds('def f(x):\n    return x < 0.02 * 3') == {'0.02'}
    assert not loose_thresholds('LIMIT = INNOVATION.threshold ** 2\nbad = x > LIMIT')


@pytest.mark.parametrize('name, sigmas', [
    ('STAR_OUTLIER', 5), ('DIVERGED', 20), ('IDENTIFICATION_DIFFERS', 10), ('TORN_FRAME', 6),
    ('LENS_ERROR', 4), ('FIRST_LINE_TIME', 3), ('LINE_TIME', 20 ** 0.5), ('HEAD_RETURNS', 3)])
def test_a_probability_gives_round_sigmas(name, sigmas):
    assert CHECKS[name].sigmas == pytest.approx(sigmas, rel=1e-12)
