# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Libraries that campaigns and benches may lack, and what to install."""

from importlib.metadata import requires

from startracker_ros.core import extras
from startracker_ros.tools.figures.machine import installed_version


def install_hint(name: str) -> str:
    """Return how to install the libraries of an extra."""
    return extras.install_hint(name, libraries()[name], './evaluation')


def libraries() -> dict[str, list[str]]:
    """Return the optional libraries by the name of the extra, as pyproject.toml has them."""
    found: dict[str, list[str]] = {}
    for requirement in requires('startracker-evaluation') or ():
        library, _, name = requirement.partition('; extra == ')
        if name:
            found.setdefault(name.strip('"\''), []).append(library)
    return found


def peer_versions(*packages: str) -> dict[str, str]:
    """Return the version of each peer, or how to install it."""
    return {package: installed_version(package) or f'absent: {install_hint("bench")}'
            for package in packages}
