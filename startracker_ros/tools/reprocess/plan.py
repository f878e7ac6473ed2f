# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which bags there are, which star trackers are in them, and the segments of each."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
import hashlib
import json
from pathlib import Path
from typing import Any

from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.folder import find_files, is_bag_folder
from startracker_ros.io.bags.layouts import camera_from_message, MessageError
from startracker_ros.io.bags.reader import (
    BagTopic, read_blocks_ns, read_messages, read_topics, why_nothing)
from startracker_ros.io.bags.remote import (
    BagPath, counted, is_url, remote_bags, Traffic, version)
from startracker_ros.io.recordings.recording import full_name
from startracker_ros.io.several_files import OneOfSeveral

IMAGE = 'sensor_msgs/msg/Image'
SOURCES = {'centroids': cdr.POINT_CLOUD, 'image_raw': IMAGE}
_SPARSE = 20_000
"""
Most camera_info of a bag that are read to find the one before each segment; none but the first
where every other frame has one, as then the segments hold their own.
"""


@dataclass(frozen=True)
class SegmentOptions(Options):
    """How recordings are cut; the result depends on these, and not on the workers."""

    segment_s: float = option(
        3600.0, 'length of a segment, by the time of recording and counted from 1970; each begins '
        'lost, as after a start', unit='s', low=1.0, high=86400.0)
    overlap_s: float = option(
        60.0, 'time before a segment from which it starts, so that it tracks when it begins; with '
        'smoothing also the time after its end that is used', unit='s', low=0.0, high=3600.0)


@dataclass(frozen=True)
class Segment:
    """
    One star tracker over one time of a bag: the piece of work of a worker.

    Messages recorded from begin_ns to end_ns count, those from start_ns on are processed, and
    with smoothing those to stop_ns.
    camera is that of the last camera_info before start_ns, or else of the first one.
    """

    bag: BagPath
    name: str
    namespace: str
    source: str
    camera: Camera
    start_ns: int
    begin_ns: int
    end_ns: int
    stop_ns: int
    identity: str

    def holds(self, log_time_ns: int) -> bool:
        """Return whether the results of a message are those of this segment."""
        return self.begin_ns <= log_time_ns < self.end_ns

    @property
    def tracker(self) -> str:
        """Return the namespace as the name of a folder."""
        return self.namespace.replace('/', '_') or 'star_tracker'

    @property
    def key(self) -> str:
        """Return a name of the segment, unique in a run."""
        return f'{self.name}/{self.tracker}/{self.begin_ns}'

    def digest(self, parameters: Mapping[str, Any]) -> str:
        """Return a hash of what the result depends on."""
        content = {**asdict(self), 'bag': self.name, 'parameters': parameters}
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()
                              ).hexdigest()


@dataclass(frozen=True)
class Problem:
    """A row of the error table: what of a bag was not processed, and why."""

    bag: str
    tracker: str
    begin_ns: int
    count: int
    reason: str


@dataclass(frozen=True)
class BagPlan:
    """The segments of one bag, and what is wrong with it; what was read of an object store."""

    segments: list[Segment] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    traffic: Traffic = field(default_factory=Traffic)


def find_bags(named: Iterable[str]) -> list[BagPath]:
    """
    Return the bags under folders, of patterns, URLs, or listed in text files; sorted.

    BagError for a name that leads to none.
    """
    found: list[BagPath] = []
    for name in named:
        path = Path(name)
        bags: list[BagPath]
        if is_url(name):
            bags = [*remote_bags(name)]
        elif path.suffix in ('.txt', '.list') and path.is_file():
            lines = [line.strip() for line in path.read_text().split('\n')]
            bags = find_bags(line if is_url(line) else str(path.parent / line)
                             for line in lines if line)
        elif path.is_dir():
            bags = [*_bags_under(path)]
        elif path.exists():
            bags = [path]
        else:
            matches = sorted(path.parent.glob(path.name)) if path.parent.is_dir() else []
            bags = [bag for match in matches
                    for bag in (_bags_under(match) if match.is_dir() else [match])]
        if not bags:
            raise BagError(f'{name}: no bag there')
        found += bags
    return sorted(set(found), key=str)


def _bags_under(folder: Path) -> list[Path]:
    """Return the folder itself if it is a bag, or all bags below it."""
    if is_bag_folder(folder):
        return [folder]
    below = sorted(child for child in folder.iterdir()
                   if child.is_dir() and not child.name.startswith('.'))
    return [bag for child in below for bag in _bags_under(child)]


def bag_names(bags: list[BagPath]) -> list[str]:
    """Return a unique name of each bag: its last parts."""
    depth = 1
    while True:
        names = ['_'.join(bag.resolve().parts[-depth:]).removesuffix('.mcap') for bag in bags]
        if len(set(names)) == len(names) or depth > 40:
            return names
        depth += 1


def plan_bag(bag: BagPath, name: str, source: str, options: SegmentOptions) -> BagPlan:
    """Return the segments of a bag; source is centroids, image_raw or empty for either."""
    with counted() as traffic:
        return replace(_planned(bag, name, source, options), traffic=traffic)


def _planned(bag: BagPath, name: str, source: str, options: SegmentOptions) -> BagPlan:
    plan = BagPlan()

    def problem(reason: str, tracker: str = '') -> None:
        plan.problems.append(Problem(name, tracker, 0, 1, reason))
    with OneOfSeveral(problem):
        try:
            topics = read_topics(bag)
        except BagError as error:
            topics = read_topics(bag, tolerant=True)
            problem(f'{error}: what is whole is used')
        if not any(topic.message_count for topic in topics.values()):
            problem('the bag holds no messages')
            return plan
        identity = _identity(bag)
        trackers = _trackers(topics, source)
        if not trackers:
            problem('no star tracker in it: ' + why_nothing(topics, {
                f'*/{kind}': SOURCES[kind] for kind in ([source] if source else SOURCES)}))
        for namespace, topic in sorted(trackers.items()):
            try:
                plan.segments.extend(_segments(
                    bag, name, namespace, topic, topics, options, identity))
            except (BagError, MessageError) as error:
                problem(str(error), namespace)
    return plan


def _trackers(topics: Mapping[str, BagTopic], source: str) -> dict[str, str]:
    """Return the source of each namespace with a star tracker."""
    found: dict[str, str] = {}
    for kind in reversed([source] if source else list(SOURCES)):
        for name, topic in topics.items():
            if (name.endswith(f'/{kind}') and topic.type_name == SOURCES[kind]
                    and topic.message_count):
                found[name.removesuffix(f'/{kind}').strip('/')] = kind
    return found


def _identity(bag: BagPath) -> str:
    """Return a text that changes when the bag does: sizes and times of its files."""
    versions = [version(path) for path in find_files(bag, lambda problem: None).paths]
    return hashlib.sha256(str(versions).encode()).hexdigest()


def _segments(bag: BagPath, name: str, namespace: str, source: str,
              topics: Mapping[str, BagTopic], options: SegmentOptions, identity: str
              ) -> list[Segment]:
    cameras = _cameras(bag, full_name(namespace, 'camera_info'), topics,
                       min(_SPARSE, topics[full_name(namespace, source)].message_count // 2))
    length_ns, overlap_ns = (round(seconds * 1e9) for seconds in (
        options.segment_s, options.overlap_s))
    segments = []
    for number in _occupied(bag, full_name(namespace, source), length_ns):
        begin_ns = number * length_ns
        start_ns = max(begin_ns - overlap_ns, 0)
        before = [camera for log_ns, camera in cameras if log_ns < start_ns]
        segments.append(Segment(
            bag, name, namespace, source, before[-1] if before else cameras[0][1], start_ns,
            begin_ns, begin_ns + length_ns, begin_ns + length_ns + overlap_ns, identity))
    return segments


def _cameras(bag: BagPath, topic: str, topics: Mapping[str, BagTopic], most: int
             ) -> list[tuple[int, Camera]]:
    """Return log times and cameras, the first only of more than most; BagError without one."""
    if topic not in topics or not topics[topic].message_count:
        raise BagError(f'no {topic}: the focal length is unknown; record it as well')
    found: list[tuple[int, Camera]] = []
    reason = 'none can be read'
    for message in read_messages(bag, topics=(topic,), tolerant=True):
        try:
            found.append((message.log_time_ns, camera_from_message(message.decoded())))
        except CameraError as error:
            # A driver may not have its calibration from the start.
            reason = str(error)
            continue
        if topics[topic].message_count > most:
            break
    if not found:
        raise BagError(f'{topic}: {reason}')
    return found


def _occupied(bag: BagPath, topic: str, length_ns: int) -> list[int]:
    """Return the numbers of the segments that hold messages."""
    spans = read_blocks_ns(bag)
    if spans and all(end_ns - start_ns <= length_ns for start_ns, end_ns in spans):
        return sorted({number for start_ns, end_ns in spans
                       for number in range(start_ns // length_ns, end_ns // length_ns + 1)})
    # A clock that jumps: a block may span years.
    return sorted({message.log_time_ns // length_ns
                   for message in read_messages(bag, topics=(topic,), tolerant=True)})
