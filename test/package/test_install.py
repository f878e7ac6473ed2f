# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""pip and colcon both leave a package that ROS 2 finds and whose nodes start."""

from collections.abc import Iterator
from dataclasses import dataclass
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tarfile
from threading import Timer
import venv

from catkin_pkg.package import parse_package
import pytest
from startracker_ros import __version__
from startracker_ros.ros.executables import EXECUTABLES
from startracker_ros.ros.processes import take_domain

SOURCE = Path(__file__).parents[2]
PARTS = ('LICENSE', 'MANIFEST.in', 'NOTICE', 'config', 'launch', 'native', 'package.xml',
         'pyproject.toml', 'resource', 'setup.cfg', 'setup.py', 'startracker_ros')
COLCON = Path(sysconfig.get_path('scripts')) / 'colcon'
LIB = Path('lib', 'startracker_ros')
SHARE = Path('share', 'startracker_ros')


@dataclass(frozen=True)
class Install:
    """An installed copy: its ament prefix, where Python finds its modules, its command."""

    route: str
    prefix: Path
    modules: Path
    command: Path
    environment: dict[str, str]
    symlinked: bool = False


def output(command: list, **options) -> str:
    """Run a command to its end and return what it prints; a failure shows all of it."""
    done = subprocess.run(command, stdin=subprocess.DEVNULL, text=True, **options,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    return done.stdout


def environment_of(prefix: Path, scripts: Path, python_path: str) -> dict[str, str]:
    """Return the environment in which an install is used, on a ROS domain of its own."""
    return {**os.environ, 'AMENT_PREFIX_PATH': str(prefix), 'PYTHONPATH': python_path,
            'PATH': f'{scripts}{os.pathsep}{os.environ["PATH"]}',
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_DOMAIN_ID': take_domain()}


def copy_source(folder: Path) -> Path:
    """Copy what an install is made of, so that building leaves nothing in the source tree."""
    for part in PARTS:
        if (SOURCE / part).is_dir():
            shutil.copytree(SOURCE / part, folder / part,
                            ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy2(SOURCE / part, folder)
    return folder


def install_with_pip(folder: Path) -> Install:
    """Install into a new venv that has this environment's dependencies."""
    prefix = folder / 'venv'
    venv.create(prefix, symlinks=True)
    scheme = {'base': str(prefix), 'platbase': str(prefix)}
    modules = Path(sysconfig.get_path('purelib', 'venv', scheme))
    dependencies = [path for path in sys.path if path.endswith('-packages')]
    (modules / 'dependencies.pth').write_text('\n'.join(dependencies) + '\n')
    source = folder / 'source'
    source.mkdir()
    environment = environment_of(prefix, prefix / 'bin', '')
    output([prefix / 'bin' / 'python', '-m', 'pip', 'install', '--no-index', '--no-deps',
            '--no-build-isolation', '--ignore-installed', copy_source(source)], env=environment)
    return Install('pip', prefix, modules, prefix / 'bin' / 'startracker', environment)


def install_with_colcon(folder: Path, *options: str) -> Install:
    """Build a workspace with the package in it."""
    source = folder / 'src' / 'startracker_ros'
    source.mkdir(parents=True)
    copy_source(source)
    assert output([COLCON, 'list'], cwd=folder).split() == [
        'startracker_ros', 'src/startracker_ros', '(ros.ament_python)']
    output([COLCON, 'build', '--merge-install', *options], cwd=folder)
    assert {path.name for path in source.iterdir()} == set(PARTS)
    prefix = folder / 'install'
    python_path, command = output(
        ['sh', '-c', '. install/setup.sh && echo "$PYTHONPATH" && command -v startracker'],
        cwd=folder).splitlines()
    modules = Path(python_path.partition(os.pathsep)[0])
    return Install('colcon', prefix, modules, Path(command),
                   environment_of(prefix, Path(sys.executable).parent, python_path),
                   symlinked='--symlink-install' in options)


@pytest.fixture(scope='module', params=[
    'pip', 'colcon', pytest.param('colcon --symlink-install', marks=pytest.mark.long)])
def install(request, tmp_path_factory) -> Iterator[Install]:
    folder = tmp_path_factory.mktemp('install')
    if request.param == 'pip':
        yield install_with_pip(folder)
    else:
        yield install_with_colcon(folder, *request.param.split()[1:])
    shutil.rmtree(folder)


def test_ros_finds_package_and_files(install):
    marker = install.prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    assert (marker / 'startracker_ros').is_file()
    share = install.prefix / SHARE
    for file in ['package.xml', *(path.relative_to(SOURCE) for folder in ('config', 'launch')
                                  for path in (SOURCE / folder).glob('*.*'))]:
        assert (share / file).read_bytes() == (SOURCE / file).read_bytes()


def test_all_modules_and_data_are_installed(install):
    def files(folder: Path) -> set[Path]:
        return {path.relative_to(folder) for pattern in ('*.py', '*.npz', '*.txt', '*.css', '*.j2',
                                                                '*.js', '*.json')
                for path in (folder / 'startracker_ros').rglob(pattern)}

    assert files(install.modules) == files(SOURCE)
    used = output(['python3', '-c', 'import startracker_ros; print(startracker_ros.__file__)'],
                  env=install.environment, cwd=install.prefix)
    assert Path(used.strip()).parents[1] == install.modules


def test_the_native_core_is_installed(install):
    library = install.modules / 'startracker_ros' / 'core' / 'libstartracker.so'
    assert library.is_file()
    loaded = output(['python3', '-c', 'from startracker_ros.core import native; '
                     'print(native.build_text(), native.LIBRARY)'], env=install.environment,
                    cwd=install.prefix)
    assert loaded.split()[-1] == str(library)
    if install.route == 'pip':
        # One wheel for all Pythons of the platform.
        folder, = install.modules.glob('startracker_ros-*.dist-info')
        assert re.search('^Tag: py3-none-linux_', (folder / 'WHEEL').read_text(), re.MULTILINE)


def test_a_source_distribution_has_the_sources_of_the_native_core(tmp_path):
    source = copy_source(tmp_path)
    output([sys.executable, 'setup.py', '-q', 'sdist'], cwd=source)
    archive, = (source / 'dist').iterdir()
    with tarfile.open(archive) as tar:
        names = {name.partition('/')[2] for name in tar.getnames()}
    assert {path.relative_to(SOURCE).as_posix() for path in (SOURCE / 'native').rglob('*.*')
            if path.suffix in ('.c', '.cpp', '.h', '.md', '.py', '.txt')} <= names


def test_licences_are_beside_package_xml_and_in_the_metadata(install):
    share = install.prefix / SHARE
    for file in ['NOTICE', *(licence.file for licence in parse_package(share).licenses)]:
        assert (share / file).read_bytes() == (SOURCE / file).read_bytes()
    # colcon installs no metadata of licences.
    if install.route == 'pip':
        folder, = install.modules.glob('startracker_ros-*.dist-info')
        licences = {path.relative_to(folder / 'licenses').as_posix()
                    for path in (folder / 'licenses').rglob('*') if path.is_file()}
        assert {'LICENSE', 'NOTICE'} < licences and len(licences) == 3
        # The name of the field depends on the version of setuptools.
        assert re.search('^License(-Expression)?: Apache-2.0 AND CC-BY-SA-3.0-IGO$',
                         (folder / 'METADATA').read_text(), re.MULTILINE)


def test_every_node_is_an_executable_of_the_package(install):
    scripts = {path.name for path in (install.prefix / LIB).iterdir()}
    assert scripts == set(EXECUTABLES) | ({'startracker'} if install.route == 'colcon' else set())
    assert all(os.access(install.prefix / LIB / name, os.X_OK) for name in scripts)
    if install.route == 'pip':
        assert not {path.name for path in (install.prefix / 'bin').iterdir()} & set(EXECUTABLES)


def test_command_line_runs(install):
    assert install.command.parent == install.prefix / 'bin'
    assert __version__ in output([install.command, '--version'], env=install.environment)


def test_node_starts_and_ends_cleanly(install, tmp_path):
    node = subprocess.Popen(
        [install.prefix / LIB / 'bag_recorder', '--ros-args', '-p', f'folder:={tmp_path / "bag"}'],
        env=install.environment, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    # A node that hangs ends the test by its exit code.
    watchdog = Timer(60.0, node.kill)
    watchdog.start()
    with node:
        lines = []
        for line in node.stdout:
            lines.append(line)
            if 'ready' in line:
                node.send_signal(signal.SIGTERM)
    watchdog.cancel()
    assert node.returncode == 0, ''.join(lines)
    assert any('ready' in line for line in lines)
