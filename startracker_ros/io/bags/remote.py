# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags in an object store: listed once, then read in ranges of bytes, never as a whole."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any

from startracker_ros.core.extras import extra
from startracker_ros.io.bags.errors import BagError

_BAG_FILES = ('*.mcap', '*.mcap.zstd', '*.db3', '*.db3.zstd', 'metadata.yaml')
# What file systems give, the first that is there: it changes when the content does.
_VERSIONS = ('ETag', 'etag', 'md5Hash', 'LastModified', 'last_modified', 'mtime', 'created')
# A request takes the time of a megabyte: a small file comes as a whole. After a jump less is read
# ahead, and twice as much with each read that follows the one before.
_FIRST_AHEAD, _LEAST_AHEAD, _MOST_AHEAD = 2 ** 20, 2 ** 16, 2 ** 23


class StoreError(Exception):
    """
    An object store does not give what it has listed; the text names the URL.

    No OSError: a reader of damaged bags would take it for damage, and go on without the bytes.
    """


@dataclass
class Traffic:
    """Requests to object stores for bytes, and the bytes that came."""

    requests: int = 0
    bytes: int = 0

    def add(self, requests: int, size: int) -> None:
        """Count requests and their bytes."""
        self.requests += requests
        self.bytes += size


_traffic: ContextVar[Traffic | None] = ContextVar('traffic', default=None)


@contextmanager
def counted() -> Iterator[Traffic]:
    """Yield what this thread reads of object stores meanwhile."""
    traffic = Traffic()
    token = _traffic.set(traffic)
    try:
        yield traffic
    finally:
        _traffic.reset(token)


@dataclass(frozen=True)
class RemotePath:
    """
    A file at a URL, or a bag folder with its files; with those methods of Path that readers use.

    version changes with the content; a path that is not in the store has none.
    """

    url: str
    size: int = 0
    version: str = ''
    files: tuple['RemotePath', ...] = ()

    def __str__(self) -> str:
        return self.url

    def __truediv__(self, name: str) -> 'RemotePath':
        """Return the file of that name of a folder."""
        url = f'{self.url}/{name}'
        return next((file for file in self.files if file.url == url), RemotePath(url))

    @property
    def name(self) -> str:
        """The last part."""
        return self.parts[-1]

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of the path, the bucket among them."""
        return PurePosixPath(self.url.partition('://')[2]).parts

    def resolve(self) -> 'RemotePath':
        """Return this path: there are no links."""
        return self

    def is_dir(self) -> bool:
        """Return whether this is a bag folder."""
        return bool(self.files)

    def is_file(self) -> bool:
        """Return whether the store has this file."""
        return bool(self.version)

    exists = is_file

    def glob(self, pattern: str) -> list['RemotePath']:
        """Return the files of a folder whose names match."""
        return [file for file in self.files if fnmatch(file.name, pattern)]

    def open(self, mode: str = 'rb') -> 'RemoteFile':
        """Open a file for reading of bytes."""
        return RemoteFile(self)


class RemoteFile:
    """The bytes of a file at a URL as a binary file; StoreError where they do not come."""

    def __init__(self, path: RemotePath) -> None:
        self._path, (self._system, self._place) = path, located(path.url)
        self._at = 0
        self._start, self._data, self._ahead = 0, b'', _FIRST_AHEAD

    def __enter__(self) -> 'RemoteFile':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Forget what was read."""
        self._data = b''

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a byte, counted from the begin (0), from here (1) or from the end (2)."""
        self._at = offset + (0, self._at, self._path.size)[whence]
        return self._at

    def read(self, count: int = -1) -> bytes:
        """Return the next bytes, fewer at the end of the file."""
        end = self._path.size if count < 0 else min(self._at + count, self._path.size)
        if end <= self._at:
            return b''
        known_end = self._start + len(self._data)
        if not self._start <= self._at < end <= known_end:
            follows = self._start <= self._at <= known_end
            if self._data:
                self._ahead = min(2 * self._ahead, _MOST_AHEAD) if follows else _LEAST_AHEAD
            self._fetch(max(end, min(self._at + self._ahead, self._path.size)))
        at, self._at = self._at - self._start, end
        return self._data[at:end - self._start]

    def _fetch(self, end: int) -> None:
        """Get the bytes from here to an end, one request."""
        try:
            data = self._system.cat_file(self._place, start=self._at, end=end)
        # The library of a store may raise anything.
        except Exception as error:
            raise StoreError(f'{self._path}: {error or type(error).__name__}') from error
        if traffic := _traffic.get():
            traffic.add(1, len(data))
        if len(data) != end - self._at:
            raise StoreError(f'{self._path}: {len(data)} bytes at {self._at}, not '
                             f'{end - self._at}: it is not the file that was listed')
        self._start, self._data = self._at, data


BagPath = Path | RemotePath


def version(file: BagPath) -> tuple[int, int | str]:
    """Return the size of a file and its time, or what its store has instead."""
    if isinstance(file, RemotePath):
        return file.size, file.version
    stat = file.stat()
    return stat.st_size, stat.st_mtime_ns


def is_url(name: str) -> bool:
    """Return whether a name is a URL, as s3://bucket/flight."""
    return '://' in name


def located(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path there; ImportError or ValueError."""
    with extra('scale', 'fsspec', 'A bag at a URL'):
        from fsspec.core import url_to_fs
    return url_to_fs(url)


def remote_bags(url: str) -> list[RemotePath]:
    """
    Return the bags of a URL, a pattern maybe: folders with files of a bag, or a file it names.

    BagError where there is none, or the file system of the URL cannot be used.
    """
    folders: dict[str, list[RemotePath]] = {}
    bags = []
    try:
        system, root = located(url)
        system.invalidate_cache()
        for name in sorted(system.glob(root)) if any(mark in root for mark in '*?[') else [root]:
            for path, information in system.find(name, detail=True).items():
                # The oldest fsspec finds a file that is named itself without a word about it.
                file = _file(system.unstrip_protocol(path), information or system.info(path))
                if not any(fnmatch(file.name, kind) for kind in _BAG_FILES):
                    continue
                if path == name:
                    bags.append(file)
                else:
                    folders.setdefault(file.url.rpartition('/')[0], []).append(file)
    # The library of a store may raise anything.
    except Exception as error:
        raise BagError(f'{url}: {error or type(error).__name__}') from error
    bags += [RemotePath(folder, files=tuple(files)) for folder, files in folders.items()]
    if not bags:
        raise BagError(f'{url}: no bag there')
    return bags


def _file(url: str, information: Mapping[str, Any]) -> RemotePath:
    version = next((str(information[key]) for key in _VERSIONS if information.get(key)), 'none')
    return RemotePath(url, int(information['size'] or 0), version)
