# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Libraries that campaigns and benches may lack, and what to install."""

from startracker_ros.core import extras
from startracker_ros.tools.figures.machine import installed_version

# As pyproject.toml has them.
EXTRAS = {
    'bench': ['mcap>=1.6', 'photutils', 'pyehm', 'sep', 'stonesoup', 'tetra3rs'],
    'gnc': ['bsk>=2.12'],
}
"""Optional libraries by the name of the extra."""


def install_hint(name: str) -> str:
    """Return how to install the libraries of an extra."""
    return extras.install_hint(name, EXTRAS[name], './evaluation')


def peer_versions(*packages: str) -> dict[str, str]:
    """Return the version of each peer, or how to install it."""
    return {package: installed_version(package) or f'absent: {install_hint("bench")}'
            for package in packages}
