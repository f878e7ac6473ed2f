# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that commands write: complete and on the disk, or not there."""

from collections.abc import Iterator
from contextlib import contextmanager
import errno
import os
from pathlib import Path
from typing import Any, BinaryIO

from startracker_ros.core.folders import replaced


class OutputError(OSError):
    """A file or folder cannot be written; the text names it and the reason."""

    def __str__(self) -> str:
        return f'{self.filename}: {self.strerror}'


@contextmanager
def output_file(path: str | Path) -> Iterator[BinaryIO]:
    """
    Yield a new file, open to write, that replaces the one at path when it is complete.

    Its folder must exist. A device or pipe is written as it is. OutputError where that fails,
    and then what was at path before is still there.
    """
    with _named(path):
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            with target.open('wb') as file:
                yield file
            return
        if not target.parent.is_dir():
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
        if target.exists() and not os.access(target, os.W_OK):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        with replaced(target) as file:
            yield file
            file.flush()
            # Some file systems report a full disk only now.
            os.fsync(file.fileno())


def write_output(path: str | Path, content: str | bytes) -> None:
    """Write a file as output_file() does, text as UTF-8."""
    with output_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_picture(path: str | Path, figure: Any, **options: Any) -> None:
    """Write a figure of matplotlib as a PNG file; options are those of its savefig()."""
    with output_file(path) as file:
        figure.savefig(file, format='png', **options)


def save_picture(figure: Any, path: Path) -> Path:
    """Write the figure of a campaign, its folder made where it is missing; return the path."""
    output_folder(path.parent)
    write_picture(path, figure, dpi=90)
    return path


def check_output(path: str | Path) -> None:
    """Raise OutputError where output_file() would, before long work and not after it."""
    with _named(path):
        target = Path(path).resolve()
        if target.exists():
            target.open('ab').close()
        else:
            # An empty file shows that there is a place for the new one.
            target.open('xb').close()
            target.unlink()


def output_folder(path: str | Path) -> Path:
    """Return a folder, made if it is not there; OutputError where that fails."""
    folder = Path(path)
    with _named(path):
        if folder.exists() and not folder.is_dir():
            raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """Raise OutputError, with the path as it was given, for an error of the system."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(error.errno, error.strerror or str(error), str(path)) from error
