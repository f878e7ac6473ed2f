# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command reprocess: plans, hands segments to workers, resumes, puts the run together."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import (
    BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn)
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.mcap_file import McapFile
from startracker_ros.io.bags.qos import qos_from_yaml
from startracker_ros.io.bags.remote import BagPath, Traffic
from startracker_ros.io.bags.writer import bag_information, FileRecord, to_yaml, TopicRecord
from startracker_ros.io.export.tables import load_parquet_writer
from startracker_ros.io.output import check_output, output_folder, write_output
from startracker_ros.io.table import Result
from startracker_ros.io.workers import cluster, completed
from startracker_ros.tools.reprocess.parameters import ParameterSet
from startracker_ros.tools.reprocess.plan import (
    bag_names, find_bags, plan_bag, Problem, Segment, SegmentOptions)
from startracker_ros.tools.reprocess.tables import SUMMARY
from startracker_ros.tools.reprocess.work import (
    finished, Outputs, process, remove_partial, SegmentRecord)

ERRORS = 'errors.json'
NOTHING = 'none'


@dataclass(frozen=True)
class Request:
    """What the user wants of a run; source is empty for either."""

    bags: Sequence[str]
    folder: Path
    source: str
    segments: SegmentOptions
    bag_topics: frozenset[str]
    smooth: bool
    sets: Sequence[ParameterSet]


@dataclass(frozen=True)
class RunRow:
    """
    A row of the summary: one star tracker of one bag with one set of parameters.

    cross_rms_arcsec is the error across the boresight on each axis, nees its normalised square, 3
    when the covariance is true; None without truth.
    """

    bag: str
    frames: int
    with_attitude_percent: float
    cross_rms_arcsec: float | None
    nees: float | None
    problems: int
    tracker: str
    parameters: str
    segments: int
    reused: int
    smoothed_rms_arcsec: float | None
    smoothed_nees: float | None


def reprocess(request: Request, *, workers: int, scheduler: str = '') -> Result:
    """
    Process all bags with all sets of parameters; a row for each bag, tracker and set.

    Finished segments of an earlier run with the same parameters are kept. What fails is in
    errors.json of the folder; the condition not_processed has the bags and segments of which
    nothing is in the run. BagError where there is no bag that can be processed, OSError where the
    folder cannot be written.
    """
    load_parquet_writer()
    check_output(output_folder(request.folder) / ERRORS)
    bags = find_bags(request.bags)
    names = bag_names(bags)
    with cluster(workers, scheduler) as client:
        segments, problems, traffic = _plan(client, bags, names, request)
        runs = [_Run(item, request, segments) for item in request.sets]
        _process(client, runs)
    rows: list[RunRow] = []
    for run in runs:
        run.finish(problems)
        rows += run.rows()
    found = problems + [problem for run in runs for problem in run.problems]
    if not rows and found:
        raise BagError(f'nothing to process: {found[0].bag}: {found[0].reason}; all problems are '
                       f'in {runs[0].folder / ERRORS}')
    with_segments = {segment.name for segment in segments}
    without = [name for name in names if name not in with_segments]
    frames = sum(row.frames for row in rows)
    for record in (record for run in runs for record in run.processed):
        traffic.add(record.store_requests, record.store_bytes)
    return Result('reprocess', rows, {
        'frames': frames,
        'cpu_s': sum(run.cpu_s for run in runs),
        'peak_worker_mb': max((run.peak_mb for run in runs), default=0.0),
        'store_requests': traffic.requests,
        'store_mb': traffic.bytes / 1e6,
        'errors': f'{len(found)} rows in {ERRORS}' if found else NOTHING,
        **({} if frames else {'first_error': (
            f'{found[0].bag}: {found[0].reason}' if found else
            'no message of the source lies in a segment')}),
        'not_processed': ', '.join([*without, *(
            key for run in runs for key in run.not_processed)]) or NOTHING})


def _plan(client: Any, bags: Sequence[BagPath], names: Sequence[str], request: Request
          ) -> tuple[list[Segment], list[Problem], Traffic]:
    """Return the segments of all bags, in their order, what is wrong with bags, what it read."""
    tasks = [(bag.resolve(), name, request.source, request.segments)
             for bag, name in zip(bags, names)]
    plans: dict[int, Any] = dict(completed(client, plan_bag, tasks))
    segments: list[Segment] = []
    problems: list[Problem] = []
    traffic = Traffic()
    for number, name in enumerate(names):
        plan = plans[number]
        if isinstance(plan, Exception):
            problems.append(Problem(name, '', 0, 1, _text(plan)))
        else:
            segments += plan.segments
            problems += plan.problems
            traffic.add(plan.traffic.requests, plan.traffic.bytes)
    return segments, problems, traffic


class _Run:
    """One set of parameters over all segments."""

    def __init__(self, parameters: ParameterSet, request: Request,
                 segments: Sequence[Segment]) -> None:
        self.parameters = parameters
        self.folder = (request.folder / parameters.name).resolve()
        self.outputs = Outputs(self.folder, request.bag_topics, request.smooth)
        self.segments = segments
        settings = {'options': asdict(parameters.options), 'topics': sorted(request.bag_topics),
                    'smooth': request.smooth}
        self.digests = {segment.key: segment.digest(settings) for segment in segments}
        self.records: dict[str, SegmentRecord] = {}
        self.reused: set[str] = set()
        self.problems: list[Problem] = []

    def missing(self) -> list[tuple]:
        """Return the tasks that an earlier run did not finish, without what it left of them."""
        remove_partial(self.folder)
        tasks = []
        for segment in self.segments:
            record = finished(self.folder, segment, self.digests[segment.key])
            if record is None:
                tasks.append((segment, self.parameters.options, self.digests[segment.key],
                              self.outputs))
            else:
                self.records[segment.key] = record
                self.reused.add(segment.key)
        return tasks

    @property
    def not_processed(self) -> list[str]:
        """Return the keys of the segments that failed, with the name of a set of parameters."""
        return [f'{self.parameters.name}/{segment.key}'.lstrip('/') for segment in self.segments
                if segment.key not in self.records]

    @property
    def peak_mb(self) -> float:
        """Return the memory of the largest worker."""
        return max((record.peak_mb for record in self.records.values()), default=0.0)

    @property
    def cpu_s(self) -> float:
        """Return the CPU time of the segments that this run processed."""
        return sum(record.cpu_s for record in self.processed)

    @property
    def processed(self) -> list[SegmentRecord]:
        """Return the records of the segments that this run processed."""
        return [record for key, record in self.records.items() if key not in self.reused]

    def finish(self, problems: Sequence[Problem]) -> None:
        """Write metadata of the bags, the error table and the summary."""
        for segment in self.segments:
            record = self.records.get(segment.key)
            for reason, count in (record.problems if record else {}).items():
                self.problems.append(Problem(
                    segment.name, segment.namespace, segment.begin_ns, count, reason))
        write_metadata(self.folder, self.records.values())
        _write_json(self.folder / ERRORS, [
            asdict(problem) for problem in (*problems, *self.problems)])
        _write_json(self.folder / SUMMARY, {
            'parameters': dict(self.parameters.values),
            'trackers': sorted({segment.tracker for segment in self.segments}),
            'rows': [asdict(row) for row in self.rows()]})

    def rows(self) -> list[RunRow]:
        """Return a row for each bag and tracker."""
        found = Counter((problem.bag, problem.tracker, problem.begin_ns)
                        for problem in self.problems)
        groups: dict[tuple[str, str], list[Segment]] = {}
        for segment in self.segments:
            groups.setdefault((segment.name, segment.tracker), []).append(segment)
        rows = []
        for (name, tracker), segments in groups.items():
            records = [self.records[segment.key] for segment in segments
                       if segment.key in self.records]
            frames = sum(record.frames for record in records)
            attitudes = sum(record.attitudes for record in records)
            problems = sum(found[name, segment.namespace, segment.begin_ns]
                           for segment in segments)
            rows.append(RunRow(
                name, frames, 100 * attitudes / frames if frames else 0.0,
                *_means([record.accuracy for record in records]), problems, tracker,
                self.parameters.name, len(segments),
                sum(segment.key in self.reused for segment in segments),
                *_means([record.smoothed for record in records])))
        return rows


def _process(client: Any, runs: Sequence[_Run]) -> None:
    """Process what is missing of all runs, with a progress bar."""
    tasks = [(run, task) for run in runs for task in run.missing()]
    frames = Counter[str]()
    with Progress(TextColumn('reprocess'), BarColumn(), MofNCompleteColumn(),
                  TextColumn('{task.fields[rate]}'), TimeElapsedColumn(),
                  TimeRemainingColumn(), transient=True) as progress:
        shown = progress.add_task('', total=len(tasks), rate='')
        for number, record in completed(client, process, [task for _, task in tasks]):
            run, (segment, *_) = tasks[number]
            if isinstance(record, Exception):
                run.problems.append(Problem(segment.name, segment.namespace, segment.begin_ns, 1,
                                            f'segment not processed: {_text(record)}'))
            else:
                run.records[segment.key] = record
                frames['all'] += record.frames
            elapsed_s = progress.tasks[0].elapsed or 1e-9
            progress.update(shown, advance=1, rate=f'{frames["all"] / elapsed_s:.0f} frames/s')


def _means(parts: Sequence[tuple[int, float, float]]) -> tuple[float | None, float | None]:
    """Return rms on each axis and mean NEES of sums, None of no frames."""
    count, squares, nees = np.sum(parts, axis=0) if parts else (0, 0.0, 0.0)
    return (float(np.sqrt(squares / 2 / count)), float(nees / count)) if count else (None, None)


def _text(error: Exception) -> str:
    """Return what failed in words."""
    if type(error).__name__ == 'KilledWorker':
        return 'its worker was lost three times, killed or out of memory'
    return str(error) or type(error).__name__


def _write_json(path: Path, content: object) -> None:
    output_folder(path.parent)
    write_output(path, json.dumps(content, indent=1, default=str) + '\n')


def write_metadata(folder: Path, records: Iterable[SegmentRecord]) -> None:
    """Write metadata.yaml into each bag folder of a run, with its files in the order of time."""
    files: dict[Path, list[Path]] = {}
    for record in records:
        for name in record.files:
            if name.endswith('.mcap'):
                files.setdefault((folder / name).parent, []).append(folder / name)
    for bag, paths in files.items():
        information = _information(paths)
        write_output(bag / 'metadata.yaml',
                     to_yaml({'rosbag2_bagfile_information': information}))


def _information(paths: list[Path]) -> dict:
    """Return the metadata of a bag of these files."""
    topics: dict[str, TopicRecord] = {}
    found = []
    for path in paths:
        with McapFile(path) as file:
            counts = file.statistics.channel_message_counts if file.statistics else {}
            found.append(FileRecord(path.name, sum(counts.values()), file.span_ns))
            for channel in file.channels.values():
                schema = file.schemas[channel.schema_id]
                topic = topics.setdefault(channel.topic, TopicRecord(
                    channel.topic, schema.name, channel.metadata['topic_type_hash'],
                    qos_from_yaml(channel.metadata['offered_qos_profiles'])))
                topic.message_count += counts.get(channel.id, 0)
    found.sort(key=lambda record: record.span_ns or (0, 0))
    return bag_information(found, list(topics.values()))
