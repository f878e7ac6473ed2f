# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The files of a bag folder, as its metadata.yaml names them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from startracker_ros.core.yaml_text import load_yaml
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.remote import BagPath

_MAX_METADATA_BYTES = 2 ** 24
_PACKED = '.zstd'
_SUFFIXES = {'mcap': '.mcap', 'sqlite3': '.db3'}


@dataclass(frozen=True)
class BagFiles:
    """The files in the order of recording, and what each message is compressed with, if any."""

    paths: tuple[BagPath, ...]
    message_compression: str = ''


def is_bag_folder(folder: Path) -> bool:
    """Return whether a folder is a bag, one that was not closed included."""
    return (folder / 'metadata.yaml').is_file() or any(
        any(folder.glob(f'*{suffix}*')) for suffix in _SUFFIXES.values())


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag and no images."""
    if path.is_dir():
        return is_bag_folder(path)
    return path.suffix in ('.mcap', '.db3', '.zstd')


def find_files(bag: BagPath | str, report: Callable[[str], None] | None) -> BagFiles:
    """
    Return the files of a bag folder, or the file itself; BagError if they cannot be read.

    Without a metadata.yaml, which a killed recorder does not write, these are all .mcap files, or
    .db3 files where there are none.
    With report, a damaged metadata.yaml is reported and ignored.
    """
    bag = Path(bag) if isinstance(bag, str) else bag
    if not bag.is_dir():
        return BagFiles((bag,))
    found: tuple[BagPath, ...] = next((
        tuple(sorted(paths, key=_order)) for suffix in _SUFFIXES.values()
        for packed in ('', _PACKED) if (paths := [*bag.glob(f'*{suffix}{packed}')])), ())
    metadata = bag / 'metadata.yaml'
    if metadata.is_file():
        try:
            return _named_files(bag, _information(metadata))
        except _MetadataError as error:
            if report is None or not found:
                raise BagError(f'{metadata}: {error}') from error
            report(f'{metadata}: {error}')
    if not found:
        raise BagError(f'{bag} holds no .mcap and no .db3 file')
    return BagFiles(found)


def _order(path: BagPath) -> tuple[int, str]:
    """Return the key of the order of recording: run_2 before run_10."""
    return len(path.name), path.name


class _MetadataError(ValueError):
    """A metadata.yaml without usable content."""


def _information(path: BagPath) -> dict[str, Any]:
    try:
        with path.open('rb') as file:
            text = file.read(_MAX_METADATA_BYTES + 1)
        if len(text) > _MAX_METADATA_BYTES:
            raise _MetadataError(f'more than {_MAX_METADATA_BYTES} bytes are not metadata')
        document = load_yaml(text)
    except OSError as error:
        raise _MetadataError(str(error.strerror)) from error
    except ValueError as error:
        raise _MetadataError(str(error)) from error
    information = document.get('rosbag2_bagfile_information') if isinstance(
        document, dict) else None
    if not isinstance(information, dict):
        raise _MetadataError('no rosbag2_bagfile_information')
    return information


def _named_files(bag: BagPath, information: dict[str, Any]) -> BagFiles:
    storage = information.get('storage_identifier')
    if storage not in _SUFFIXES:
        raise BagError(f'{bag} is stored as {storage}, only {" and ".join(_SUFFIXES)} can be '
                       'read; on a ROS install `ros2 bag convert` makes an mcap bag of it, see '
                       'docs/bags.md')
    names = information.get('relative_file_paths')
    if not isinstance(names, list) or not names or not all(
            isinstance(name, str) and name for name in names):
        raise _MetadataError(f'relative_file_paths = {names!r} names no files')
    mode, compression = (str(information.get(key) or '').lower()
                         for key in ('compression_mode', 'compression_format'))
    paths = []
    for name in names:
        # Before version 4 the name of the folder stood before that of the file.
        own = PurePosixPath(name).name
        # The last two were unpacked by hand, or compressed by hand.
        path = next((path for path in (
            bag / name, bag / own, bag / own.removesuffix(_PACKED), bag / (own + _PACKED))
            if path.exists()), bag / own)
        if isinstance(path, Path) and not path.resolve().is_relative_to(str(bag.resolve())):
            raise BagError(f'{bag}: metadata.yaml names {name!r}, outside of the folder')
        if not path.is_file():
            raise _MetadataError(f'{name!r} is not there')
        paths.append(path)
    if mode == 'file' and compression != 'zstd':
        raise BagError(f'{bag} was compressed by rosbag2 as whole files with {compression}, only '
                       'zstd can be read: unpack them first')
    return BagFiles(tuple(paths), compression if mode == 'message' else '')
