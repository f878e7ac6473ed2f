# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a year of a constellation takes: scheduler, object store, processors; from small runs."""

from collections.abc import Sequence
from dataclasses import replace
import os
from pathlib import Path
import struct
from tempfile import TemporaryDirectory
import time
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, Schema
import psutil
from startracker_evaluation.bench.reprocess import flight_bag, processed
from startracker_ros.io.bags.mcap_file import FRAME, MAGIC, McapFile, read_summary
from startracker_ros.io.bags.remote import remote_bags
from startracker_ros.io.table import Result
from startracker_ros.io.workers import cluster, completed, MOST_TASKS
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.tools.figures.machine import machine, StealTime
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.reprocess.plan import BagPlan
from startracker_ros.tools.reprocess.work import SegmentRecord

# --- a valid bag of any size whose images are holes of the file ---

_IMAGE = 60_000
"""Id of the channel and schema of the images, which a recording does not reach."""

# Of a chunk without CRC and compression: times, size, CRC, length of a name, size.
_CHUNK_HEAD = struct.Struct('<QQQLLQ')
_MESSAGE_HEAD = struct.Struct('<HLQQ')


def write_sparse_bag(source: Path, path: Path, size: int, image_bytes: int) -> int:
    """
    Write the chunks of an MCAP file and around them chunks of one image each; return their number.

    The images, on /camera/image_raw, are all zeros, and make the file as large as size.
    """
    images = -(-size // image_bytes)
    with McapFile(source) as file, open(source, 'rb') as stream, open(path, 'wb') as out:
        chunks = [*read_summary(stream, file.size).chunks.values()]
        out.write(MAGIC)
        indexes = []
        for number, chunk in enumerate(chunks):
            begin, end = (k * images // len(chunks) for k in (number, number + 1))
            for k in range(begin, end):
                if k == (begin + end) // 2:
                    indexes.append(_copied(stream, chunk, out))
                indexes.append(_add_image(out, chunk.message_start_time if k < (begin + end) // 2
                                          else chunk.message_end_time, image_bytes))
        summary = RecordBuilder()
        DataEnd(0).write(summary)
        start = out.tell() + summary.count
        for schema in (*file.schemas.values(),
                       Schema(id=_IMAGE, data=b'', encoding='', name='sensor_msgs/msg/Image')):
            schema.write(summary)
        for channel in (*file.channels.values(), Channel(
                id=_IMAGE, topic='/camera/image_raw', message_encoding='cdr', metadata={},
                schema_id=_IMAGE)):
            channel.write(summary)
        assert file.statistics is not None
        file.statistics.chunk_count = len(indexes)
        file.statistics.message_count += images
        file.statistics.channel_message_counts[_IMAGE] = images
        file.statistics.write(summary)
        for index in indexes:
            index.write(summary)
        Footer(summary_start=start, summary_offset_start=0, summary_crc=0).write(summary)
        out.write(summary.end() + MAGIC)
    return images


def _copied(stream: BinaryIO, chunk: ChunkIndex, out: BinaryIO) -> ChunkIndex:
    """Copy a chunk without its message indexes; return its index there."""
    at = out.tell()
    stream.seek(chunk.chunk_start_offset)
    out.write(stream.read(chunk.chunk_length))
    return replace(chunk, chunk_start_offset=at, message_index_length=0)


def _add_image(out: BinaryIO, log_time_ns: int, image_bytes: int) -> ChunkIndex:
    """Write the heads of a chunk and of its message, and leave out its zeros."""
    at = out.tell()
    size = FRAME.size + _MESSAGE_HEAD.size + image_bytes
    out.write(FRAME.pack(Opcode.CHUNK, _CHUNK_HEAD.size + size)
              + _CHUNK_HEAD.pack(log_time_ns, log_time_ns, size, 0, 0, size)
              + FRAME.pack(Opcode.MESSAGE, _MESSAGE_HEAD.size + image_bytes)
              + _MESSAGE_HEAD.pack(_IMAGE, 0, log_time_ns, log_time_ns))
    out.seek(image_bytes, 1)
    return ChunkIndex(
        chunk_length=out.tell() - at, chunk_start_offset=at, compression='',
        compressed_size=size, message_end_time=log_time_ns, message_index_length=0,
        message_index_offsets={_IMAGE: 0}, message_start_time=log_time_ns, uncompressed_size=size)


# --- the bench ---

CASES = ('scheduler', 'sparse', 'year')
HEADS, RATE_HZ, YEAR_S, SEGMENT_S = 1000, 10.0, 365 * 86_400, 3600.0
YEAR_FRAMES = HEADS * RATE_HZ * YEAR_S
UNIT_FRAMES = 1e9
SPARSE_BYTES, IMAGE_BYTES = 50 * 10 ** 9, 10 ** 7
FLIGHT_FRAMES, WARM_UP_FRAMES = 36_000, 1000


def run_constellation_bench(*, trials: int, seed: int, only: Sequence[str] = CASES) -> Result:
    """Give a scheduler trials empty tasks, and reprocess a flight at a URL."""
    steal, rows = StealTime(), list[Row]()
    tasks_s = _scheduler_rows(trials, rows) if {'scheduler', 'year'} & {*only} else 0.0
    if {'sparse', 'year'} & {*only}:
        with TemporaryDirectory() as name:
            _flight_rows(Path(name), seed, tasks_s, only, rows)
    return Result('bench constellation', rows, {
        'constellation': f'{HEADS} heads at {RATE_HZ:g} Hz for a year, {YEAR_FRAMES:.3g} frames; '
                         f'segments of {SEGMENT_S:g} s',
        'scheduler': f'empty tasks on two workers, at most {MOST_TASKS} of them at a time',
        'flight': f'{FLIGHT_FRAMES} frames of centroids, one head, {RATE_HZ:g} Hz, at a URL; '
                  'tables only',
        'machine': machine(str(steal))})


def _nothing(number: int) -> int:
    return number


def _scheduler_rows(trials: int, rows: list[Row]) -> float:
    """Add rates and memory of a scheduler and its client, in this process; return tasks/s."""
    process_memory = psutil.Process(os.getpid()).memory_info
    tasks = [(number,) for number in range(trials)]
    with cluster(2) as client:
        client.submit(_nothing, 0).result()
        for count in (trials // 10, trials):
            start, begin_s = process_memory().rss, time.perf_counter()
            for _ in completed(client, _nothing, tasks[:count]):
                pass
            tasks_s = count / (time.perf_counter() - begin_s)
            rows.append(Row(f'scheduler: {count} tasks', tasks_s, 'tasks/s'))
            rows.append(Row(f'scheduler: {count} tasks, more memory, with the client',
                            (process_memory().rss - start) / 1e6, 'MB'))
    return tasks_s


def _flight_rows(folder: Path, seed: int, tasks_s: float, only: Sequence[str], rows: list[Row]
                 ) -> None:
    file = _flight(folder / 'flight', FLIGHT_FRAMES, seed)
    if 'sparse' in only:
        path = folder / 'sparse.mcap'
        write_sparse_bag(file, path, SPARSE_BYTES, IMAGE_BYTES)
        plan, records = _reprocessed(path, folder / 'out sparse')
        size = plan.traffic.bytes + sum(record.store_bytes for record in records)
        rows.append(Row('sparse bag: size', path.stat().st_size / 1e9, 'GB'))
        rows.append(Row('sparse bag: read of the store', size / 1e6, 'MB'))
        rows.append(Row('sparse bag: requests', plan.traffic.requests + sum(
            record.store_requests for record in records), 'requests'))
    if 'year' in only:
        # Once before: files are read.
        _reprocessed(_flight(folder / 'warm-up', WARM_UP_FRAMES, seed), folder / 'out warm-up')
        _year_rows(file, *_reprocessed(file, folder / 'out'), tasks_s, rows)


def _flight(folder: Path, frames: int, seed: int) -> Path:
    """Write the bag of a flight; return its file."""
    return next(flight_bag(folder, FlightOptions(
        days=frames / RATE_HZ / 86_400, bag_hours=1.0, rate_hz=RATE_HZ, heads=1), seed).glob(
            '*.mcap'))


def _reprocessed(path: Path, folder: Path) -> tuple[BagPlan, list[SegmentRecord]]:
    """Return plan and records of a file at a URL, processed in this process."""
    bag, = remote_bags(f'file://{path}')
    return processed(bag, folder)


def _year_rows(file: Path, plan: BagPlan, records: Sequence[SegmentRecord], tasks_s: float,
               rows: list[Row]) -> None:
    """Add what a year takes by the figures of a flight."""
    frames = sum(record.frames for record in records)
    frame_s = sum(record.cpu_s for record in records) / frames
    frame_bytes = (plan.traffic.bytes + sum(record.store_bytes for record in records)) / frames
    tasks = HEADS * YEAR_S / SEGMENT_S
    rows += [
        Row('flight: frames', 1 / frame_s, 'frames/s of CPU'),
        Row('flight: size', file.stat().st_size / frames, 'B/frame'),
        Row('flight: read of the store', frame_bytes, 'B/frame'),
        Row('10^9 frames: processors', UNIT_FRAMES * frame_s / 3600, 'h'),
        Row('10^9 frames: read of the store', UNIT_FRAMES * frame_bytes / 1e9, 'GB'),
        Row('10^9 frames: segments', UNIT_FRAMES / RATE_HZ / SEGMENT_S, 'tasks'),
        Row('year: frames', YEAR_FRAMES, 'frames'),
        Row('year: segments', tasks, 'tasks'),
        Row('year: read of the store', YEAR_FRAMES * frame_bytes / 1e12, 'TB'),
        Row('year: processors', YEAR_FRAMES * frame_s / 3600, 'h'),
        Row('year: the scheduler alone', tasks / tasks_s / 3600, 'h'),
        Row('processors that one scheduler feeds', tasks_s * SEGMENT_S * RATE_HZ * frame_s,
            'cores'),
        Row('read of the store by so many', tasks_s * SEGMENT_S * RATE_HZ * frame_bytes / 1e9,
            'GB/s')]
