"""Pair databases in the user's cache folder, keyed by a hash of what they are built from."""

from contextlib import suppress
from dataclasses import fields
import hashlib
import io
import logging
import os
from pathlib import Path
from uuid import uuid4

import numpy as np
from startracker_ros.catalog.onboard import OnboardCatalog
from startracker_ros.folders import cache_folder, MAX_DATABASE_BYTES, stored_databases
from startracker_ros.identify.pairs import build_pairs, MOST_PAIRS, PairDatabase

# To be raised whenever the same input would give other pairs or another layout.
_VERSION = 2


def cached_pairs(onboard: OnboardCatalog, min_separation_rad: float,
                 max_separation_rad: float, most_pairs: float = MOST_PAIRS) -> PairDatabase:
    """
    Return the pairs of the catalogue from the cache, or build and store them.

    The file begins with the SHA-256 of its content; a file that does not match is
    rebuilt. Where the folder cannot be written, the pairs are built each time. The last used
    files remain, up to MAX_DATABASE_BYTES.
    """
    key = hashlib.sha256(
        repr((_VERSION, min_separation_rad, max_separation_rad, most_pairs)).encode())
    for field in fields(OnboardCatalog):
        key.update(np.ascontiguousarray(getattr(onboard, field.name)).tobytes())
    path = cache_folder() / f'pairs-{key.hexdigest()[:32]}.bin'
    pairs = _load(path)
    if pairs is None:
        pairs = build_pairs(onboard, min_separation_rad, max_separation_rad, most_pairs)
        _store(path, pairs)
    return pairs


def _load(path: Path) -> PairDatabase | None:
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, body = content[:32], memoryview(content)[32:]
    if hashlib.sha256(body).digest() != digest:
        logging.getLogger(__name__).warning('%s is damaged and is rebuilt', path)
        return None
    # The file of another user can be read but not touched.
    with suppress(OSError):
        os.utime(path)
    stream = io.BytesIO(body)
    return PairDatabase(*(np.load(stream, allow_pickle=False) for _ in fields(PairDatabase)))


def _store(path: Path, pairs: PairDatabase) -> None:
    stream = io.BytesIO()
    for field in fields(PairDatabase):
        np.save(stream, getattr(pairs, field.name), allow_pickle=False)
    body = stream.getbuffer()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Renamed when complete: another process never reads a partial file.
        part = path.with_name(f'{path.stem}-{uuid4().hex}.part')
        try:
            with part.open('wb') as stored:
                stored.write(hashlib.sha256(body).digest())
                stored.write(body)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        _delete_oldest(path.parent)
    except OSError as error:
        logging.getLogger(__name__).warning(
            'pattern database is not cached in %s: %s', path.parent, error.strerror)


def _delete_oldest(folder: Path) -> None:
    """Delete the least recently used files beyond MAX_DATABASE_BYTES, whoever has made them."""
    total = 0
    for file, size in stored_databases(folder):
        total += size
        if total > MAX_DATABASE_BYTES:
            file.unlink(missing_ok=True)
