"""The folders of the package import only downward in the map of docs/architecture.md."""

import ast
from functools import cache
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / 'startracker_ros'
MAX_FILE_LINES, MAX_FUNCTION_LINES, MAX_NODE_LINES = 400, 60, 120
ROS_PACKAGE = re.compile(r'(rclpy|rosidl_\w+|rpyutils|\w+_(msgs|srvs|interfaces))(\.|$)')
FILES = sorted(PACKAGE.rglob('*.py'))


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
    """Return the entry of the map for a file or folder, None for the package itself."""
    relative = path.relative_to(PACKAGE)
    if path.suffix != '.py':
        return f'{relative.as_posix()}/' if relative.parts else None
    if len(relative.parts) == 1:
        return None if relative.name == '__init__.py' else relative.name
    return f'{relative.parent.as_posix()}/'


def unit_of_module(module: str) -> str | None:
    """Return the entry of the map for startracker_ros.x.y, None when it is no module."""
    path = PACKAGE.joinpath(*module.split('.')[1:])
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
    found = {unit_of_module(name) for name in imports_of(path)
             if name.split('.')[0] == PACKAGE.name}
    return found - {None, unit_of(path)}


def files_of(unit: str) -> list[Path]:
    return [path for path in FILES if unit_of(path) == unit]


def test_the_map_lists_what_exists():
    assert set(MAP) == {unit_of(path) for path in FILES} - {None}


@pytest.mark.parametrize('unit', MAP)
def test_imports_point_downward(unit):
    upward = {f'{path.relative_to(PACKAGE)} imports {other}' for path in files_of(unit)
              for other in own_imports(path) if LEVEL.get(other, -1) <= LEVEL[unit]}
    assert not upward


@pytest.mark.parametrize('unit', [unit for unit, group in MAP.items() if group == 'flight'])
def test_flight_code_does_not_import_the_simulator(unit):
    assert not [path for path in files_of(unit) if 'sky/' in own_imports(path)]


def test_the_simulator_imports_the_ground_only():
    assert not {f'{path.name} imports {other}' for path in files_of('sky/')
                for other in own_imports(path) if MAP.get(other) != 'ground'}


def test_only_the_ros_folders_import_ros():
    assert not {f'{path.relative_to(PACKAGE)} imports {name}' for path in FILES
                if MAP.get(unit_of(path)) != 'ros'
                for name in imports_of(path) if ROS_PACKAGE.match(name)}


def test_files_are_short():
    def most(path):
        return MAX_NODE_LINES if unit_of(path) == 'ros/nodes/' else MAX_FILE_LINES
    lines = {path: len(path.read_text().splitlines()) for path in FILES}
    assert not {str(path.relative_to(PACKAGE)): count for path, count in lines.items()
                if count > most(path)}


def test_functions_are_short():
    assert not {f'{path.relative_to(PACKAGE)}: {node.name}': count for path in FILES
                for node in ast.walk(tree_of(path))
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
                and (count := node.end_lineno - node.lineno + 1) > MAX_FUNCTION_LINES}
