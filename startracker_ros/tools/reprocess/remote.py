# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags at URLs: copies of their files in a folder of this machine."""

from pathlib import Path, PurePosixPath

from startracker_ros.core.extras import extra
from startracker_ros.io.bags.errors import BagError

_BAG_FILES = ('*.mcap', '*.mcap.zstd', 'metadata.yaml')


def is_url(name: str) -> bool:
    """Return whether a name is a URL, as s3://bucket/flight."""
    return '://' in name


def fetch(url: str, folder: Path) -> list[Path]:
    """
    Copy the bags of a URL, a pattern maybe, below a folder; return the copies of what it names.

    Files that are there with the same size are kept. BagError where there is no bag, or the file
    system of the URL cannot be used; OSError where a copy cannot be written.
    """
    with extra('scale', 'fsspec', 'A bag at a URL'):
        from fsspec.core import url_to_fs
    try:
        system, root = url_to_fs(url)
        named = sorted(system.glob(root)) if any(mark in root for mark in '*?[') else [root]
        files = {name: [file for file in system.find(name)
                        if any(PurePosixPath(file).match(kind) for kind in _BAG_FILES)]
                 for name in named}
        sizes = {file: int(system.size(file)) for found in files.values() for file in found}
    except (ImportError, ValueError, OSError) as error:
        raise BagError(f'{url}: {error or type(error).__name__}') from error
    if not sizes:
        raise BagError(f'{url}: no bag there')
    for file, size in sizes.items():
        copy = _copy_of(file, folder)
        if copy.is_file() and copy.stat().st_size == size:
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        part = copy.with_name(copy.name + '.part')
        try:
            system.get_file(file, str(part))
        except OSError as error:
            raise BagError(f'{url}: {file}: {error}') from error
        part.replace(copy)
    return [_copy_of(name, folder) for name, found in files.items() if found]


def _copy_of(file: str, folder: Path) -> Path:
    return folder.joinpath(*(part for part in PurePosixPath(file).parts
                             if part not in ('/', '..')))
