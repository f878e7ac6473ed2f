# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is installed, and the folders for pattern databases and bags."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module, metadata
import os
from pathlib import Path
import shutil
import sys

from startracker_ros.core.folders import (
    cache_folder, CACHE_VARIABLE, cached_files, can_write, most_cache_bytes)
from startracker_ros.ros.executables import EXECUTABLES


# --- a row of the examination ---


@dataclass(frozen=True)
class Check:
    """
    What was looked at, what was found, whether that will do, and how to fix it.

    A check that holds may still carry advice in `mend`.
    """

    check: str
    result: str
    holds: bool = True
    mend: str = ''


# --- the install ---

# Modules with the distributions that have their versions; Debian packages may have none.
PACKAGES = (
    ('numpy', 'numpy'), ('scipy', 'scipy'),
    ('cv2', 'opencv-python-headless'), ('mcap', 'mcap'), ('mcap_ros2', 'mcap-ros2-support'),
    ('lz4', 'lz4'), ('zstandard', 'zstandard'), ('psutil', 'psutil'), ('yaml', 'PyYAML'),
    ('rclpy', 'ros-rclpy'), ('sensor_msgs.msg', 'ros-sensor-msgs'))
_OLDEST_PYTHON = (3, 11)
_ENV_SHEBANG = b'#!/usr/bin/env python3'

# The demo, 1024 x 1024 px at 10 Hz, writes 10 MB a second.
_BAG_BYTES_S = 10e6
_LEAST_FREE_BYTES = 2e9


def check_install() -> Iterator[Check]:
    """Yield the checks of what is installed."""
    yield check_python()
    yield check_packages(PACKAGES)
    yield check_native()
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


def check_native() -> Check:
    """Return compiler and oldest processor of the native core, or why it cannot be loaded."""
    from startracker_ros.core.native import build_text, LIBRARY, NativeError, REMEDY
    try:
        return Check('native core', f'{build_text()}, {LIBRARY}')
    except NativeError as error:
        return Check('native core', str(error).removesuffix(f': {REMEDY}'), False, REMEDY)


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


def check_storage() -> Iterator[Check]:
    """Yield the checks of what is kept on disk."""
    yield check_cache(cache_folder())
    yield check_disk(Path.cwd())


def check_cache(folder: Path) -> Check:
    """Return whether databases can be kept in the folder."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not can_write(existing):
        return Check('database cache', f'{folder} cannot be written', False,
                     'make it writable, or set XDG_CACHE_HOME')
    sizes = [size for _, size in cached_files(folder)]
    return Check('database cache', f'{len(sizes)} files, {sum(sizes) / 1e6:.1f} of at most '
                                   f'{most_cache_bytes() / 1e6:g} MB ({CACHE_VARIABLE}), in '
                                   f'{folder}')


def check_disk(folder: Path) -> Check:
    """Return whether a bag can be written into the folder."""
    if not can_write(folder):
        return Check('room for bags', f'{folder} cannot be written', False,
                     'record into another folder: startracker record -o FOLDER')
    free = shutil.disk_usage(folder).free
    holds = free >= _LEAST_FREE_BYTES
    return Check('room for bags', f'{free / 1e9:.1f} GB free in {folder}: '
                                  f'{free / _BAG_BYTES_S / 60:.0f} min of 1 Mpx at 10 Hz',
                 holds, '' if holds else 'make room, or record without image_raw')
