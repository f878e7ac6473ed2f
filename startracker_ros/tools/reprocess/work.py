# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a worker does: a segment processed, its files in place, its record next to them."""

from dataclasses import asdict, dataclass
import hashlib
import json
from pathlib import Path
import resource
import shutil
from tempfile import TemporaryDirectory
from typing import Any

from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.io.bags.remote import counted
from startracker_ros.tools.reprocess.leftovers import Leftovers
from startracker_ros.tools.reprocess.output import SegmentBag
from startracker_ros.tools.reprocess.plan import Segment
from startracker_ros.tools.reprocess.segment import segment_folder, SegmentRun
from startracker_ros.tools.reprocess.smoothing import Smoothing
from startracker_ros.tools.reprocess.tables import accuracy, SegmentTables, write_tables

RECORDS = '.segments'
_PARTIAL = '.partial-'
_TRACK_IDS = 1 << 16
_MAX_TRACK_IDS = 1 << 32


@dataclass(frozen=True)
class Outputs:
    """Where a run goes, and what is written: bag topics, none for no bags, smoothed attitudes."""

    folder: Path
    bag_topics: frozenset[str]
    smooth: bool


@dataclass(frozen=True)
class SegmentRecord:
    """
    What became of a segment: its files with their hashes, its problems with their counts.

    peak_mb is the most memory that the worker had in use up to its end; accuracy and smoothed
    are those of tables.accuracy(); the store is where the bag is at a URL.
    """

    key: str
    digest: str
    files: dict[str, str]
    frames: int
    attitudes: int
    cpu_s: float
    peak_mb: float
    accuracy: tuple[int, float, float]
    smoothed: tuple[int, float, float]
    problems: dict[str, int]
    store_requests: int
    store_bytes: int


def process(segment: Segment, options: StarTrackerOptions, digest: str, outputs: Outputs
            ) -> SegmentRecord:
    """
    Process a segment and put its files into place, whole or not at all; return the record.

    OSError where they cannot be written, SegmentError where it cannot be processed.
    """
    folder = outputs.folder
    tables, leftovers = SegmentTables(), Leftovers()
    smoothing = Smoothing(options) if outputs.smooth else None
    (folder / RECORDS).mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=_PARTIAL, dir=folder / RECORDS) as name:
        partial = Path(name)
        bag_folder = segment_folder(partial, segment)
        # Ids of two segments may meet after 65,536 of them only.
        first_id = segment.begin_ns // (segment.end_ns - segment.begin_ns) * _TRACK_IDS
        bag = SegmentBag(bag_folder, segment.namespace, outputs.bag_topics,
                         first_id % _MAX_TRACK_IDS) if outputs.bag_topics else None
        try:
            with counted() as traffic:
                tally = SegmentRun(segment, options, bag, tables, leftovers, smoothing).run()
        finally:
            if bag is not None:
                bag.close()
        found = (tables.tables(segment.begin_ns, segment.camera)
                 | leftovers.tables(segment.begin_ns))
        if smoothing is not None:
            found['smoothed'] = smoothing.table()
        paths = write_tables(found, partial / 'tables', segment.tracker, bag_folder.name)
        moves = {f'tables/{path}': partial / 'tables' / path for path in paths}
        if bag is not None and tally.frames:
            file, = bag_folder.glob('*.mcap')
            moves[f'bags/{segment.name}/{segment.tracker}/{file.name}'] = file
        files = {}
        for place, file in moves.items():
            files[place] = sha256(file)
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            file.replace(folder / place)
    record = SegmentRecord(
        segment.key, digest, files, tally.frames, tally.attitudes, tally.cpu_s,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        accuracy(found['frames']),
        accuracy(found['smoothed']) if smoothing is not None else (0, 0.0, 0.0),
        dict(tally.problems), traffic.requests, traffic.bytes)
    path = record_path(folder, segment)
    path.parent.mkdir(parents=True, exist_ok=True)
    written = path.with_suffix('.new')
    written.write_text(json.dumps(asdict(record)))
    written.replace(path)
    return record


def remove_partial(folder: Path) -> None:
    """Remove what killed workers left of segments that they did not finish."""
    for path in (folder / RECORDS).glob(f'{_PARTIAL}*'):
        shutil.rmtree(path, ignore_errors=True)


def record_path(folder: Path, segment: Segment) -> Path:
    """Return the file with the record of a segment."""
    return folder / RECORDS / f'{segment.key}.json'


def finished(folder: Path, segment: Segment, digest: str) -> SegmentRecord | None:
    """Return the record of a segment that is done with these parameters, its files intact."""
    try:
        content: dict[str, Any] = json.loads(record_path(folder, segment).read_text())
        record = SegmentRecord(**content)
        intact = record.digest == digest and all(
            sha256(folder / name) == value for name, value in record.files.items())
    except (OSError, ValueError, TypeError):
        return None
    return record if intact else None


def sha256(path: Path) -> str:
    """Return the hash of a file."""
    with open(path, 'rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()
