# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Throughput of reprocessing: frames a second, reading compared with a plain read, two workers."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.bags.remote import BagPath
from startracker_ros.io.table import Result
from startracker_ros.sim.flights.bags import write_bag
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.tools.figures.machine import machine, StealTime
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.figures.timing import cpu_timed
from startracker_ros.tools.reprocess.output import chosen_topics
from startracker_ros.tools.reprocess.parameters import parameter_sets
from startracker_ros.tools.reprocess.plan import BagPlan, plan_bag, SegmentOptions
from startracker_ros.tools.reprocess.run import reprocess, Request
from startracker_ros.tools.reprocess.work import Outputs, process, SegmentRecord

CASES = ('simulate', 'read', 'frames', 'workers')
MONTH_FRAMES = 26e6
"""30 days at 10 Hz."""

_WARM_UP_DAYS = 0.001  # at 1 Hz: files are read once, and not in each segment
MONTH_H, PARALLEL_EFFICIENCY, MEMORY_MB, READ_SHARE = 3.0, 0.9, 1000.0, 0.2


def flight_bag(folder: Path, options: FlightOptions, seed: int) -> Path:
    """Return the bag of a flight of one bag, written into a new folder."""
    folder.mkdir()
    write_bag(folder, options, seed, 0)
    bag, = folder.iterdir()
    return bag


def processed(bag: BagPath, folder: Path, *, settings: Sequence[str] = (),
              topics: frozenset[str] = frozenset(), smooth: bool = False,
              segment_s: float = 86_400.0) -> tuple[BagPlan, list[SegmentRecord]]:
    """Return plan and records of a bag, processed in this process; a folder has the results."""
    parameters, = parameter_sets((), settings)[0]
    plan = plan_bag(bag, 'flight', '', SegmentOptions(segment_s=segment_s))
    outputs = Outputs(folder, topics, smooth)
    return plan, [process(segment, parameters.options, '', outputs) for segment in plan.segments]


def run_reprocess_bench(*, trials: int, seed: int, only: Sequence[str] = CASES) -> Result:
    """Reprocess trials frames of one head at 10 Hz."""
    steal, rows = StealTime(), list[Row]()
    with TemporaryDirectory() as name:
        folder = Path(name)
        hours = trials / 36_000
        options = FlightOptions(days=hours / 24, bag_hours=hours, rate_hz=10.0, heads=1)
        write_s, bag = cpu_timed(flight_bag, folder / 'flight', options, seed)
        if 'simulate' in only:
            rows.append(Row('simulated frames', trials / write_s, 'frames/s of CPU'))
        if 'read' in only or 'frames' in only:
            read_s = _read_rows(bag, trials, rows)
        if 'frames' in only:
            _frame_rows(bag, folder, trials, read_s, rows)
        if 'workers' in only:
            _worker_rows(bag, folder, trials, rows)
    return Result('bench reprocess', rows, {
        'recording': f'{trials} frames of centroids, one head, 10 Hz with a gyro of 10 Hz',
        'machine': machine(str(steal))})


def _read_rows(bag: Path, trials: int, rows: list[Row]) -> float:
    """Add the rows of reading; return its CPU time in s."""
    files = list(bag.glob('*.mcap'))
    begin_s = time.perf_counter()
    size = sum(len(path.read_bytes()) for path in files)
    plain_s = time.perf_counter() - begin_s

    def read() -> int:
        total = 0
        for message in read_messages(bag, topics=('/head_1/centroids', '/head_1/imu')):
            total += len(message.data)
            if message.type_name == cdr.POINT_CLOUD:
                read_cloud(cdr.read_point_cloud(message.data), CENTROID_DTYPE)
            else:
                cdr.read_rates(message.data)
        return total
    read_s, total = cpu_timed(read)
    rows.append(Row('read and decode', total / read_s / 1e6, 'MB/s of messages'))
    rows.append(Row('read and decode', trials / read_s, 'frames/s of CPU'))
    rows.append(Row('plain read of the file', size / plain_s / 1e6, 'MB/s'))
    return read_s


def _frame_rows(bag: Path, folder: Path, trials: int, read_s: float, rows: list[Row]) -> None:
    """Add the frames a second of one process that is warm, with bags and without."""
    warm_up = FlightOptions(days=_WARM_UP_DAYS, bag_hours=1.0, heads=1)
    processed(flight_bag(folder / 'warm-up', warm_up, 1), folder / 'out warm-up',
              topics=chosen_topics(['*']))
    for case, topics in (('tables', frozenset[str]()), ('tables and bags', chosen_topics(['*']))):
        _, records = processed(bag, folder / f'out {case}', topics=topics)
        cpu_s = sum(record.cpu_s for record in records)
        month_h = MONTH_FRAMES / trials * cpu_s / 2 / 3600
        rows.append(Row(f'{case}: one worker', trials / cpu_s, 'frames/s of CPU'))
        rows.append(Row(f'{case}: 30 days at 10 Hz on two cores', month_h, 'h', most=MONTH_H))
        rows.append(Row(f'{case}: share of reading', read_s / cpu_s, '1', most=READ_SHARE))


def _worker_rows(bag: Path, folder: Path, trials: int, rows: list[Row]) -> None:
    """
    Add the gain of a second worker, and the memory of the largest.

    By wall time, the engine's start included, which is right on an idle machine only; and by the
    CPU time of the segments, which grows where two workers hinder each other.
    """
    sets, _ = parameter_sets((), ())
    # At least eight, none longer than those of a user.
    segment_s = min(SegmentOptions().segment_s, max(1.0, trials / 10 / 8))
    times_s, cpu_s, peak_mb = list[float](), list[float](), 0.0
    for workers in (1, 2):
        request = Request([str(bag)], folder / f'workers {workers}', '', SegmentOptions(
            segment_s=segment_s, overlap_s=min(10.0, segment_s / 10)), frozenset(), False, sets)
        begin_s = time.perf_counter()
        result = reprocess(request, workers=workers)
        times_s.append(time.perf_counter() - begin_s)
        cpu_s.append(float(str(result.conditions['cpu_s'])))
        peak_mb = max(peak_mb, float(str(result.conditions['peak_worker_mb'])))
    month_h = MONTH_FRAMES / trials * times_s[1] / 3600
    rows.append(Row('two workers: 30 days at 10 Hz, by wall time', month_h, 'h', most=MONTH_H))
    efficiency = times_s[0] / times_s[1] / 2
    rows.append(Row('two workers over twice one', efficiency, '1', least=PARALLEL_EFFICIENCY))
    rows.append(Row('CPU time of one worker over that of two', cpu_s[0] / cpu_s[1], '1',
                    least=PARALLEL_EFFICIENCY))
    rows.append(Row('memory of the largest worker', peak_mb, 'MB', most=MEMORY_MB))
