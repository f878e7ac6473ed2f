# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Libraries that may be missing, and what to install."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

# setup.py runs this file for them.
EXTRAS = {
    # Pictures, and the page of `startracker report`.
    'report': ['Jinja2>=3.1', 'matplotlib>=3.6'],
    # Campaigns on a cluster, --scheduler, and bags at URLs.
    'scale': ['dask>=2023.11', 'distributed>=2023.11', 'fsspec>=2023.9'],
    'parquet': ['pyarrow>=14.0'],
    # Space packets of telemetry_bridge.
    'telemetry': ['spacepackets>=0.28'],
    # Images of `startracker solve` in FITS, and those of digital cameras.
    'fits': ['astropy>=6.0'],
    'raw': ['rawpy>=0.18'],
    # Names of deep-sky objects in its pictures; OpenNGC, whose licence is CC-BY-SA-4.0.
    'deep-sky': ['pyongc>=1.1'],
    # A machine with ROS 2 has these; elsewhere these wheels are enough.
    'ros': ['ros-jazzy-common-interfaces', 'ros-jazzy-rclpy[fastrtps]'],
    'ros-kilted': ['ros-kilted-common-interfaces', 'ros-kilted-rclpy[fastrtps]'],
}
"""Optional libraries by the name of the extra."""


class MissingLibraryError(RuntimeError):
    """A library is not installed; the text says how to install it."""


def install_hint(name: str, libraries: Sequence[str] = (), folder: str = '.') -> str:
    """
    Return how to install the libraries of an extra: what it belongs to is on no index.

    By default of this package; folder is that of another distribution in a clone.
    """
    by_name = ' '.join(f"'{one}'" if set('[<>') & set(one) else one
                       for one in libraries or EXTRAS[name])
    clone = f"pip install '{folder}[{name}]' in a clone of startracker_ros"
    return f'pip install {by_name}, or {clone}'


@contextmanager
def extra(name: str, library: str, purpose: str) -> Iterator[None]:
    """Turn the failed import of a library into a MissingLibraryError that names its extra."""
    try:
        yield
    except ImportError as error:
        raise MissingLibraryError(
            f'{purpose} needs {library}: {install_hint(name)}') from error


@contextmanager
def with_ros() -> Iterator[None]:
    """Turn the failed import of a package of ROS 2 into a MissingLibraryError."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package != 'rclpy' and not package.endswith(('_msgs', '_interfaces')):
            raise
        raise MissingLibraryError(
            f'this needs ROS 2, and {package} is not installed: source the setup file of ROS 2, '
            f'or {install_hint("ros")}') from error


PAGE_IN = 10.0
"""Width of a figure whose text, of 10 points, is legible where a page shows it 900 px wide."""


def new_figure(**options: Any) -> Any:
    """Return a matplotlib Figure, which saves PNG files without pyplot and without a display."""
    with extra('report', 'matplotlib', 'A picture'):
        from matplotlib.figure import Figure
    return Figure(layout='constrained', **options)
