# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that commands read: one that is not there is named before anything is loaded."""

from collections.abc import Sequence
import errno
import glob
import os
from pathlib import Path
from typing import Any

import click
from startracker_ros.tools.cli.outcome import FailedError


FOV_DEG = click.FloatRange(0, 360, min_open=True)


class InputPath(click.Path):
    """The path of a file or folder to read: status 1 where it is not there."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        _require(str(value))
        return super().convert(value, param, ctx)


class InputName(click.ParamType):
    """What may also be a pattern, a URL or a device: status 1 for a path that is not there."""

    name = 'path'

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if not (glob.has_magic(value) or '://' in value or value.startswith('/dev/')):
            _require(value)
        return value


def require_some(names: Sequence[Path]) -> None:
    """Fail where none of the files, folders and patterns is there: the others are results."""
    if not any(name.exists() or glob.glob(str(name), recursive=True) for name in names):
        _require(str(names[0]))


def _require(path: str) -> None:
    if not os.path.exists(path):
        raise FailedError(f'{path}: {os.strerror(errno.ENOENT)}')
