# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings out of bags: messages checked topic by topic, and turned into arrays."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.io.bags.cdr import read_stamp
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.layouts import (
    camera_from_message, CENTROID_DTYPE, MessageError, ns_from_stamp, protection_from_message,
    read_cloud, STAR_DTYPE, TRACK_DTYPE)
from startracker_ros.io.bags.reader import (
    BagMessage, BagTopic, read_messages, read_topics, why_nothing)
from startracker_ros.io.recordings.recording import (
    ATTITUDE_TOPICS, Clouds, DiagnosticRecord, full_name, Recording, TopicTimes)

# Topics that are read, relative to the namespace of a star tracker.
TOPIC_TYPES = {
    'camera_info': 'sensor_msgs/msg/CameraInfo', 'image_raw': 'sensor_msgs/msg/Image',
    'centroids': 'sensor_msgs/msg/PointCloud2', 'stars': 'sensor_msgs/msg/PointCloud2',
    'tracks': 'sensor_msgs/msg/PointCloud2', 'attitude': 'geometry_msgs/msg/QuaternionStamped',
    'attitude_cov': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'attitude_imu': 'sensor_msgs/msg/Imu',
    'protection_level': 'geometry_msgs/msg/Vector3Stamped',
    'truth/attitude': 'geometry_msgs/msg/QuaternionStamped',
    'tracker_state': 'diagnostic_msgs/msg/DiagnosticStatus'}
HEADS_TOPIC, HEADS_TYPE = 'heads', 'diagnostic_msgs/msg/DiagnosticArray'
_DIAGNOSTICS, _DIAGNOSTICS_TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'
_FRAME_TOPICS = ('image_raw', 'centroids', 'stars', 'tracks', *ATTITUDE_TOPICS)
# Topics that identify the namespace of a star tracker; other cameras have image_raw as well.
_STAR_TRACKER_TOPICS = (*_FRAME_TOPICS[1:], 'tracker_state')
_NEWEST_NS = 2 ** 63 - 1
_LARGEST_VARIANCE_RAD2 = (2 * np.pi) ** 2


def load_recording(bag: Path, namespace: str | None = None) -> Recording:
    """
    Read a bag folder or file; BagError if it is not a bag. Images are counted, not decoded.

    namespace: of the star tracker, by default that of a fusion, or the only one in the bag;
    BagError names them if there are several. Of an unfinished or damaged bag what is whole is
    read, and problems say so, as they do of messages that are not what their topic promises.
    """
    try:
        return _load(bag, namespace, tolerant=False)
    except _UnreadableBagError as error:
        return _load(bag, namespace, tolerant=True, problems=(
            f'{error.reason}. What is whole of the bag is used.',))


class _UnreadableBagError(Exception):
    """The bag cannot be read to its end."""

    def __init__(self, reason: BagError) -> None:
        super().__init__(str(reason))
        self.reason = reason


def _load(bag: Path, namespace: str | None, *, tolerant: bool,
          problems: tuple[str, ...] = ()) -> Recording:
    try:
        topics = read_topics(bag, tolerant=tolerant)
    except BagError as error:
        # A file that is not a bag at all fails again, and then for good.
        if tolerant:
            raise
        raise _UnreadableBagError(error) from error
    namespace = _find_namespace(topics) if namespace is None else _checked(topics, namespace)
    reader = _Reader(namespace)
    messages = read_messages(bag, topics=tuple(reader.handlers), tolerant=tolerant)
    for message in messages if tolerant else _to_the_end(messages):
        reader.read(message)
    return reader.recording(topics, problems, complete=not tolerant)


def _to_the_end(messages: Iterator[BagMessage]) -> Iterator[BagMessage]:
    try:
        yield from messages
    except BagError as error:
        raise _UnreadableBagError(error) from error


def _find_namespace(topics: Mapping[str, BagTopic]) -> str:
    found = sorted({name.removesuffix(f'/{topic}').strip('/')
                    for name in topics for topic in _STAR_TRACKER_TOPICS
                    if name.endswith(f'/{topic}') and not name.endswith('/truth/attitude')
                    and not name.endswith('/truth/stars')})
    fusions = [name for name in found if is_fusion(topics, name)]
    if len(fusions) == 1:
        return fusions[0]
    if len(found) > 1:
        raise BagError(f'the bag holds several star trackers: choose the namespace '
                       f'{", ".join(repr(name) for name in found)}')
    return found[0] if found else ''


def _checked(topics: Mapping[str, BagTopic], namespace: str) -> str:
    """Return a namespace without slashes around it; BagError where no topic is in it."""
    namespace = namespace.strip('/')
    if namespace and not any(name.startswith(f'/{namespace}/') for name in topics):
        raise BagError(f'the bag has no topic in the namespace {namespace!r}; it has '
                       f'{", ".join(sorted(topics)) or "none"}')
    return namespace


def is_fusion(topics: Mapping[str, BagTopic], namespace: str) -> bool:
    """Return whether a bag has the heads of a fusion in a namespace."""
    topic = topics.get(full_name(namespace, HEADS_TOPIC))
    return topic is not None and topic.type_name == HEADS_TYPE


class _Reader:
    """Collects what messages say; what cannot be used is counted by topic."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        handlers: dict[str, Callable[[Any, BagMessage], None]] = {
            'camera_info': self._on_camera, 'centroids': self._on_cloud,
            'stars': self._on_cloud, 'tracks': self._on_cloud,
            'attitude': self._on_attitude, 'attitude_cov': self._on_pose,
            'attitude_imu': self._on_imu, 'protection_level': self._on_protection,
            'truth/attitude': self._on_truth, 'tracker_state': self._on_state}
        # Images are only looked at for their stamps.
        self.handlers = {full_name(namespace, topic): (topic, type_name, handlers.get(topic))
                         for topic, type_name in TOPIC_TYPES.items()}
        self.handlers[_DIAGNOSTICS] = (
            _DIAGNOSTICS, _DIAGNOSTICS_TYPE, self._on_diagnostics)
        self._problems: dict[str, tuple[int, str]] = {}
        self._times: dict[str, list[tuple[int, int, int]]] = {topic: [] for topic in TOPIC_TYPES}
        self._clouds: dict[str, dict[int, np.ndarray]] = {
            'centroids': {}, 'stars': {}, 'tracks': {}}
        self._camera: Camera | None = None
        self._quaternion: dict[int, np.ndarray] = {}
        self._received: dict[int, int] = {}
        self._covariance: dict[int, np.ndarray] = {}
        self._protection: dict[int, np.ndarray] = {}
        self._rate: dict[int, np.ndarray] = {}
        self._without: set[int] = set()
        self._truth: dict[int, np.ndarray] = {}
        self._state: list[tuple[int, int, str]] = []
        self._diagnostics: list[DiagnosticRecord] = []

    def read(self, message: BagMessage) -> None:
        """Take one message of the topics in handlers."""
        topic, type_name, handler = self.handlers[message.topic]
        try:
            if message.type_name != type_name:
                raise MessageError(f'type {message.type_name!r} is not {type_name}')
            if handler is None:
                self._note_time(topic, ns_from_stamp(read_stamp(message.data)), message)
            else:
                # What is not a number shows in the checks of the handlers.
                with np.errstate(all='ignore'):
                    handler(message.decoded(), message)
        except (BagError, MessageError, CameraError) as error:
            count, first = self._problems.get(message.topic, (0, str(error)))
            self._problems[message.topic] = count + 1, first

    def _stamp_ns(self, decoded: Any, message: BagMessage) -> int:
        stamp_ns = ns_from_stamp(decoded.header.stamp)
        self._note_time(self.handlers[message.topic][0], stamp_ns, message)
        return stamp_ns

    def _note_time(self, topic: str, stamp_ns: int, message: BagMessage) -> None:
        self._times[topic].append((stamp_ns, *_sent_and_received_ns(message)))

    def _on_camera(self, decoded: Any, message: BagMessage) -> None:
        self._camera = camera_from_message(decoded)

    def _on_cloud(self, decoded: Any, message: BagMessage) -> None:
        topic = self.handlers[message.topic][0]
        dtype = {'centroids': CENTROID_DTYPE, 'stars': STAR_DTYPE, 'tracks': TRACK_DTYPE}[topic]
        rows = read_cloud(decoded, dtype)
        self._clouds[topic][self._stamp_ns(decoded, message)] = rows

    def _on_attitude(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.quaternion)
        self._note_attitude(self._stamp_ns(decoded, message), quaternion, message)

    def _on_pose(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.pose.pose.orientation)
        stamp_ns = self._stamp_ns(decoded, message)
        self._note_attitude(stamp_ns, quaternion, message)
        block = np.reshape(decoded.pose.covariance, (6, 6))[3:, 3:]
        self._covariance[stamp_ns] = _about_sensor_axes(block, quaternion)

    def _on_imu(self, decoded: Any, message: BagMessage) -> None:
        if decoded.orientation_covariance[0] == -1:
            self._without.add(self._stamp_ns(decoded, message))
            return
        quaternion = _unit(decoded.orientation)
        stamp_ns = self._stamp_ns(decoded, message)
        self._note_attitude(stamp_ns, quaternion, message)
        block = np.reshape(decoded.orientation_covariance, (3, 3))
        # All zeros: the covariance is unknown, as sensor_msgs/Imu words it.
        if np.any(block):
            self._covariance.setdefault(stamp_ns, _about_sensor_axes(block, quaternion))
        if decoded.angular_velocity_covariance[0] != -1:
            rate = decoded.angular_velocity
            if np.isfinite([rate.x, rate.y, rate.z]).all():
                self._rate[stamp_ns] = np.array([rate.x, rate.y, rate.z])

    def _on_protection(self, decoded: Any, message: BagMessage) -> None:
        bound = protection_from_message(decoded)
        # A turn by more does not exist.
        self._protection[self._stamp_ns(decoded, message)] = np.where(bound < np.pi, bound, np.inf)

    def _note_attitude(self, stamp_ns: int, quaternion: np.ndarray, message: BagMessage) -> None:
        """Keep an attitude; the topic `attitude` has the last word where several tell one."""
        if stamp_ns not in self._quaternion or self.handlers[message.topic][0] == 'attitude':
            self._quaternion[stamp_ns] = quaternion
            self._received[stamp_ns] = min(message.log_time_ns, _NEWEST_NS)

    def _on_truth(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.quaternion)
        self._truth[self._stamp_ns(decoded, message)] = quaternion

    def _on_state(self, decoded: Any, message: BagMessage) -> None:
        sent_ns, received_ns = _sent_and_received_ns(message)
        self._state.append((received_ns, sent_ns, decoded.message))

    def _on_diagnostics(self, decoded: Any, message: BagMessage) -> None:
        self._diagnostics.extend(DiagnosticRecord(
            ns_from_stamp(decoded.header.stamp), min(message.log_time_ns, _NEWEST_NS),
            status.name, status.hardware_id, _level(status.level), status.message,
            tuple((value.key, value.value) for value in status.values))
            for status in decoded.status)

    def recording(self, topics: Mapping[str, BagTopic], problems: tuple[str, ...], *,
                  complete: bool) -> Recording:
        """Return all that was taken."""
        attitude_ns = sorted(self._quaternion)
        self._state.sort(key=lambda row: row[0])
        problems += tuple(
            f'{topic}: {count} of {topics[topic].message_count} messages not used: {reason}'
            for topic, (count, reason) in self._problems.items())
        if not (self._problems or any(self._times[topic] for topic in _FRAME_TOPICS)):
            problems += ('no frame of a star tracker: ' + why_nothing(topics, {
                full_name(self._namespace, topic): '' for topic in _FRAME_TOPICS}),)
        return Recording(
            namespace=self._namespace, topics=topics,
            times={topic: _topic_times(rows) for topic, rows in self._times.items()},
            camera=self._camera,
            centroids=_clouds(self._clouds['centroids'], CENTROID_DTYPE),
            stars=_clouds(self._clouds['stars'], STAR_DTYPE),
            tracks=_clouds(self._clouds['tracks'], TRACK_DTYPE),
            attitude_ns=np.array(attitude_ns, np.int64),
            attitude_received_ns=np.array([self._received[ns] for ns in attitude_ns], np.int64),
            quaternion=_table(self._quaternion, attitude_ns, (4,)),
            covariance_sensor=_table(self._covariance, attitude_ns, (3, 3)),
            protection_rad=_table(self._protection, attitude_ns, (3,)),
            rate_rad_s=_table(self._rate, attitude_ns, (3,)),
            without_attitude_ns=np.array(sorted(self._without - set(attitude_ns)), np.int64),
            truth_ns=np.array(sorted(self._truth), np.int64),
            truth_quaternion=_table(self._truth, sorted(self._truth), (4,)),
            state_ns=np.array([row[0] for row in self._state], np.int64),
            state_sent_ns=np.array([row[1] for row in self._state], np.int64),
            state=tuple(row[2] for row in self._state),
            diagnostics=tuple(self._diagnostics), problems=problems, complete=complete)


def _sent_and_received_ns(message: BagMessage) -> tuple[int, int]:
    received_ns = min(message.log_time_ns, _NEWEST_NS)
    # Recorders that do not know when a message was sent may note 0.
    return min(message.publish_time_ns or received_ns, _NEWEST_NS), received_ns


def _topic_times(rows: list[tuple[int, int, int]]) -> TopicTimes:
    return TopicTimes(*np.array(sorted(rows), np.int64).reshape(-1, 3).T)


def _clouds(frames: dict[int, np.ndarray], dtype: np.dtype) -> Clouds:
    stamps = sorted(frames)
    rows = [frames[stamp_ns] for stamp_ns in stamps]
    return Clouds(np.array(stamps, np.int64),
                  np.concatenate(rows) if rows else np.empty(0, dtype),
                  np.repeat(np.arange(len(rows)), [len(row) for row in rows]))


def _table(values: dict[int, np.ndarray], stamps: list[int], shape: tuple[int, ...]
           ) -> np.ndarray:
    unknown = np.full(shape, np.nan)
    return np.array([values.get(stamp_ns, unknown) for stamp_ns in stamps],
                    float).reshape(-1, *shape)


def _unit(q: Any) -> np.ndarray:
    quaternion = np.array([q.x, q.y, q.z, q.w])
    # Written by others, it may be rounded to float32; a rotation it must be.
    norm = np.linalg.norm(np.clip(quaternion, -2, 2))
    if not abs(norm - 1) < 1e-3:
        raise MessageError(f'quaternion {quaternion.tolist()} is not a rotation')
    return quaternion / norm


def _about_sensor_axes(covariance_icrf: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    matrix = matrix_from_quaternion(quaternion)
    covariance = matrix.T @ covariance_icrf @ matrix
    # Beyond a full turn a variance carries no information.
    known = (np.all(np.abs(covariance) < _LARGEST_VARIANCE_RAD2)
             and np.all(np.diag(covariance) >= 0))
    return covariance if known else np.full((3, 3), np.nan)


def _level(level: bytes | int) -> int:
    """Return the number of a DiagnosticStatus level, which decoders give as byte or number."""
    return level[0] if isinstance(level, bytes) else int(level)
