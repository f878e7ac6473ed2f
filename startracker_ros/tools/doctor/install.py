# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Python, packages, the ament marker and the executables of the nodes, the star catalogue."""

from collections.abc import Iterator, Sequence
from importlib import import_module, metadata
import os
from pathlib import Path
import shutil
import sys

from startracker_ros.core.extras import check_numba, MissingLibraryError, OLDEST_NUMBA
from startracker_ros.ros.executables import EXECUTABLES
from startracker_ros.tools.doctor.check import Check

# Modules with the distributions that have their versions; Debian packages may have none.
PACKAGES = (
    ('numpy', 'numpy'), ('scipy', 'scipy'), ('numba', 'numba'),
    ('cv2', 'opencv-python-headless'), ('mcap', 'mcap'), ('mcap_ros2', 'mcap-ros2-support'),
    ('lz4', 'lz4'), ('zstandard', 'zstandard'), ('psutil', 'psutil'), ('yaml', 'PyYAML'),
    ('rclpy', 'ros-rclpy'), ('sensor_msgs.msg', 'ros-sensor-msgs'))
_OLDEST_PYTHON = (3, 11)
_ENV_SHEBANG = b'#!/usr/bin/env python3'


def check_install() -> Iterator[Check]:
    """Yield the checks of what is installed."""
    yield check_python()
    yield check_packages(PACKAGES)
    yield check_compiler()
    prefixes = [prefix for prefix in (
        *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix) if prefix]
    yield from check_ament(prefixes)
    yield check_catalog()


def check_python() -> Check:
    """Return whether this Python is new enough."""
    version = '.'.join(map(str, sys.version_info[:3]))
    holds = sys.version_info[:2] >= _OLDEST_PYTHON
    return Check('Python', version, holds, '' if holds else 'install Python 3.11 or 3.12')


def check_packages(packages: Sequence[tuple[str, str]]) -> Check:
    """Return the versions of the packages, or which of them cannot be imported and why."""
    versions, broken = [], []
    for module, distribution in packages:
        try:
            import_module(module)
        # A library that does not fit its neighbours raises whatever it likes.
        except Exception as error:
            broken.append(f'{module}: {error}')
            continue
        try:
            versions.append(f'{module.partition(".")[0]} {metadata.version(distribution)}')
        except metadata.PackageNotFoundError:
            versions.append(module.partition('.')[0])
    if broken:
        return Check('packages', '; '.join(broken), False,
                     'pip install -r requirements.txt, or source the setup file of ROS 2')
    return Check('packages', ', '.join(versions))


def check_compiler() -> Check:
    """Return whether numba is new enough."""
    try:
        check_numba()
    except MissingLibraryError as error:
        finding, _, remedy = str(error).partition(': ')
        return Check('numba', finding, False, remedy)
    return Check('numba', f'{metadata.version("numba")}, needs '
                          f'{".".join(map(str, OLDEST_NUMBA))} or later')


def check_ament(prefixes: Sequence[str]) -> Iterator[Check]:
    """Yield whether ROS 2 finds the package and its nodes in one of the prefixes."""
    marker = Path('share', 'ament_index', 'resource_index', 'packages', 'startracker_ros')
    prefix = next((Path(prefix) for prefix in prefixes if (Path(prefix) / marker).is_file()), None)
    if prefix is None:
        yield Check('ament marker', 'not found', False,
                    "pip install '.[ros]', or colcon build and source install/setup.bash: "
                    'until then only startracker run finds the nodes')
        return
    yield Check('ament marker', str(prefix))
    folder = prefix / 'lib' / 'startracker_ros'
    missing = [node for node in EXECUTABLES if not os.access(folder / node, os.X_OK)]
    if missing:
        yield Check('executables', f'missing in {folder}: {", ".join(missing)}', False,
                    'install the package again')
        return
    found = shutil.which('python3')
    if ((folder / next(iter(EXECUTABLES))).read_bytes().startswith(_ENV_SHEBANG)
            and (found is None or not Path(found).parent.samefile(Path(sys.executable).parent))):
        yield Check('executables', f'{len(EXECUTABLES)}, but python3 on PATH is {found}', False,
                    f'source {sys.prefix}/bin/activate before ros2 run')
        return
    yield Check('executables', f'{len(EXECUTABLES)} in {folder}')


def check_catalog() -> Check:
    """Return whether the star catalogue can be read."""
    from startracker_ros.core.catalog.stars import CATALOG_FILE, load_catalog
    try:
        stars = load_catalog()
    # NumPy and zipfile raise many kinds for a damaged file.
    except Exception as error:
        return Check('star catalogue', f'{CATALOG_FILE}: {error}', False,
                     'install the package again')
    return Check('star catalogue', f'{len(stars)} stars to V {stars.magnitude.max():.1f}')
