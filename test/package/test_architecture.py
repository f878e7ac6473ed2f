# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The folders of package and evaluation import only downward in docs/architecture.md."""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[2]
# Where modules stand, and where their folders stand in the map.
PLACES = {'startracker_ros': ROOT / 'startracker_ros',
          'startracker_evaluation': ROOT / 'evaluation' / 'startracker_evaluation'}
RUN_NODES = {'tools/demos/', 'tools/live/', 'tools/doctor/', 'evaluation/harness/'}
GROUND = {'core/catalog/', 'core/astro/', 'core/camera/', 'core/maths/'}
ROS_PACKAGE = re.compile(r'(rclpy|rosidl_\w+|rpyutils|\w+_(msgs|srvs|interfaces))(\.|$)')
FILES = sorted(path for folder in PLACES.values() for path in folder.rglob('*.py'))


def in_map(path: Path) -> Path:
    """Return the place of a file or folder in the map."""
    if path.is_relative_to(PLACES['startracker_evaluation']):
        return Path('evaluation', path.relative_to(PLACES['startracker_evaluation']))
    return path.relative_to(PLACES['startracker_ros'])


def read_map() -> dict[str, str]:
    """Return the group of each folder and root module, from the top of the map down."""
    text = (ROOT / 'docs' / 'architecture.md').read_text()
    group, units = '', {}
    for line in text.split('```\n')[1].splitlines():
        if line.startswith('# '):
            group = line[2:]
        elif line:
            units[line.split()[0]] = group
    return units


MAP = read_map()
LEVEL = {unit: level for level, unit in enumerate(MAP)}


def unit_of(path: Path) -> str | None:
    """Return the entry of the map for a file or folder, None for the packages themselves."""
    relative = in_map(path)
    if relative.as_posix() in MAP:
        return relative.as_posix()
    folder = relative.parent if path.suffix == '.py' else relative
    if len(folder.parts) < 2 and f'{folder.as_posix()}/' not in MAP and (
            path.suffix != '.py' or relative.name == '__init__.py'):
        return None
    return f'{folder.as_posix()}/'


def unit_of_module(module: str) -> str | None:
    """Return the entry of the map for startracker_ros.x.y, None when it is not a module."""
    package, *rest = module.split('.')
    if package not in PLACES:
        return None
    path = PLACES[package].joinpath(*rest)
    if path.is_dir():
        return unit_of(path)
    return unit_of(path.with_suffix('.py')) if path.with_suffix('.py').is_file() else None


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Return the full names of all imported modules, those within functions included."""
    names = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level and node.module, f'{path}: relative import'
            # An imported name may be a module of its own, and then counts instead of its parent.
            for alias in node.names:
                full = f'{node.module}.{alias.name}'
                names.add(full if unit_of_module(full) else node.module)
    return frozenset(names)


def own_imports(path: Path) -> set[str]:
    """Return the entries of the map that a file imports, without its own."""
    found = {unit_of_module(name) for name in imports_of(path)}
    return found - {None, unit_of(path)}


def module_of(path: Path) -> str:
    """Return the full name of the module in a file."""
    package, folder = next(place for place in PLACES.items() if path.is_relative_to(place[1]))
    parts = path.relative_to(folder).with_suffix('').parts
    return '.'.join((package, *parts)).removesuffix('.__init__')


def circle_of(imports: dict[str, frozenset[str]]) -> list[str]:
    """Return modules of which each imports the one before it, empty without a circle."""
    try:
        # A package may import names of its own files.
        TopologicalSorter({name: found - {name} for name, found in imports.items()}).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def files_of(unit: str) -> list[Path]:
    return [path for path in FILES if unit_of(path) == unit]


def test_the_map_lists_what_exists():
    assert set(MAP) == {unit_of(path) for path in FILES} - {None}


@pytest.mark.parametrize('unit', MAP)
def test_imports_point_downward(unit):
    upward = {f'{in_map(path)} imports {other}' for path in files_of(unit)
              for other in own_imports(path) if LEVEL.get(other, -1) <= LEVEL[unit]}
    assert not upward


def test_no_two_modules_import_each_other():
    """Neither directly nor through others, imports in functions and for types included."""
    imports = {module_of(path): imports_of(path) for path in FILES}
    assert not circle_of(imports)
    # Nodes need the rotations: with an import back there is a circle, through others.
    back = {'startracker_ros.core.maths.rotation': frozenset({'startracker_ros.ros.camera_node'})}
    assert circle_of(imports | back)


def test_flight_code_does_not_import_the_simulator():
    assert not {f'{in_map(path)} imports {other}' for path in FILES
                if (MAP.get(unit_of(path)) == 'core')
                for other in own_imports(path) if MAP.get(other) != 'core'}


def test_the_simulator_shares_no_method_with_the_star_tracker():
    assert not {f'{path.name} imports {other}' for path in files_of('sim/sky/')
                for other in own_imports(path) if other.endswith('/') and other not in GROUND}


def test_only_what_runs_nodes_imports_ros():
    assert not {f'{in_map(path)} imports {name}' for path in FILES
                if MAP.get(unit_of(path)) != 'ros' and unit_of(path) not in RUN_NODES
                for name in imports_of(path) if ROS_PACKAGE.match(name)}
