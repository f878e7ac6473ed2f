# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of campaigns."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_picture(figure: 'Figure', path: Path) -> Path:
    """Write a figure as PNG, its folder made where it is missing; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    return path
