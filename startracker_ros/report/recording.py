"""What a recorded run says about attitude, truth, stars, states and time, as arrays."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.bag.errors import BagError
from startracker_ros.bag.layouts import (
    camera_from_message, CENTROID_DTYPE, MessageError, read_cloud, STAR_DTYPE, TRACK_DTYPE)
from startracker_ros.bag.reader import BagMessage, BagTopic, decode, read_messages, read_topics
from startracker_ros.camera.model import Camera, CameraError
from startracker_ros.maths.rotation import ARCSEC, attitude_error, matrix_from_quaternion

# Topics that are understood, relative to the namespace of a star tracker.
TOPIC_TYPES = {
    'camera_info': 'sensor_msgs/msg/CameraInfo', 'image_raw': 'sensor_msgs/msg/Image',
    'centroids': 'sensor_msgs/msg/PointCloud2', 'stars': 'sensor_msgs/msg/PointCloud2',
    'tracks': 'sensor_msgs/msg/PointCloud2', 'attitude': 'geometry_msgs/msg/QuaternionStamped',
    'attitude_cov': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'attitude_imu': 'sensor_msgs/msg/Imu',
    'truth/attitude': 'geometry_msgs/msg/QuaternionStamped',
    'tracker_state': 'diagnostic_msgs/msg/DiagnosticStatus'}
_DIAGNOSTICS, _DIAGNOSTICS_TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'
# What tells that a namespace is one of a star tracker; other cameras have image_raw as well.
_TELLING = ('centroids', 'stars', 'tracks', 'attitude', 'attitude_cov', 'attitude_imu',
            'tracker_state')
_NEWEST_NS = 2 ** 63 - 1
_LARGEST_VARIANCE_RAD2 = (2 * np.pi) ** 2


@dataclass(frozen=True)
class TopicTimes:
    """When the messages of a topic are valid, were sent and came to the recorder, ns, (N,)."""

    stamp_ns: np.ndarray
    sent_ns: np.ndarray
    received_ns: np.ndarray

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(frozen=True)
class Clouds:
    """Point clouds of many frames: stamp_ns (F,), all rows (N,), the frame (N,) of each row."""

    stamp_ns: np.ndarray
    rows: np.ndarray
    frame: np.ndarray

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def count(self, which: np.ndarray | None = None) -> np.ndarray:
        """Return how many rows each frame has, (F,), of those where which (N,) is true."""
        frame = self.frame if which is None else self.frame[which]
        return np.bincount(frame, minlength=len(self))

    def of_frame(self, frame: int) -> np.ndarray:
        """Return the rows of one frame."""
        return self.rows[self.frame == frame]


@dataclass(frozen=True)
class DiagnosticRecord:
    """One status of /diagnostics; level 0 is good, 1 a warning, 2 an error, 3 stale."""

    stamp_ns: int
    received_ns: int
    name: str
    hardware_id: str
    level: int
    message: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Recording:
    """
    One star tracker's run; stamps are int64 ns since the UNIX epoch, sorted.

    times: TopicTimes by relative topic, of all that carry a stamp;
    quaternion (N, 4) at attitude_ns (N,), covariance_sensor (N, 3, 3) in rad^2 about sensor
    axes and rate_rad_s (N, 3), both NaN where they were not told;
    without_attitude_ns: frames of which the estimator said that they have none;
    truth_ns (T,), truth_quaternion (T, 4); state_ns and state: the tracker's states, by the
    time they were received; problems: what of the bag could not be used; complete: whether it
    could be read to its end.
    """

    namespace: str
    topics: Mapping[str, BagTopic]
    times: Mapping[str, TopicTimes]
    camera: Camera | None
    centroids: Clouds
    stars: Clouds
    tracks: Clouds
    attitude_ns: np.ndarray
    attitude_received_ns: np.ndarray
    quaternion: np.ndarray
    covariance_sensor: np.ndarray
    rate_rad_s: np.ndarray
    without_attitude_ns: np.ndarray
    truth_ns: np.ndarray
    truth_quaternion: np.ndarray
    state_ns: np.ndarray
    state: tuple[str, ...]
    diagnostics: tuple[DiagnosticRecord, ...]
    problems: tuple[str, ...]
    complete: bool

    @property
    def image_ns(self) -> np.ndarray:
        """Stamps of the images."""
        return self.times['image_raw'].stamp_ns

    @property
    def centroids_ns(self) -> np.ndarray:
        """Stamps of the frames whose centroids were extracted."""
        return self.times['centroids'].stamp_ns

    def full_name(self, topic: str) -> str:
        """Return the name in the bag of a relative topic."""
        return _full_name(self.namespace, topic)

    def errors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return stamps (M,), the errors and their sigmas (M, 3) in arcsec about sensor axes.

        Only frames that have both an attitude and a truth with the same stamp.
        """
        stamps, ours, truth = np.intersect1d(self.attitude_ns, self.truth_ns,
                                             return_indices=True)
        error = attitude_error(self.quaternion[ours], self.truth_quaternion[truth])
        return stamps, error / ARCSEC, self.sigma_arcsec()[ours]

    def sigma_arcsec(self) -> np.ndarray:
        """Return 1 sigma (N, 3) of each attitude about sensor axes; NaN where not told."""
        variance = np.diagonal(self.covariance_sensor, axis1=1, axis2=2)
        return np.sqrt(np.where(variance >= 0, variance, np.nan)) / ARCSEC

    def latency_ms(self) -> np.ndarray:
        """Return the time from sending an image to receiving its attitude, each frame (M,)."""
        images = self.times['image_raw']
        _, image, ours = np.intersect1d(images.stamp_ns, self.attitude_ns, return_indices=True)
        return (self.attitude_received_ns[ours] - images.sent_ns[image]) / 1e6

    def stage_ms(self, first: str, last: str) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (M,) and ms (M,) from sending first to sending last, of one frame."""
        start, end = self.times[first], self.times[last]
        stamps, i, j = np.intersect1d(start.stamp_ns, end.stamp_ns, return_indices=True)
        return stamps, (end.sent_ns[j] - start.sent_ns[i]) / 1e6

    def frame_ns(self) -> np.ndarray:
        """Return the stamps of all frames that any stage knows of."""
        return np.unique(np.concatenate([
            *(self.times[topic].stamp_ns for topic in ('image_raw', 'centroids', 'tracks')),
            self.attitude_ns, self.without_attitude_ns]))

    def receipt_delay_ns(self) -> int:
        """
        Return how much later than its stamp a frame's message is received, the median.

        States carry no stamp: this brings the time of their receipt to that of the frames.
        """
        for topic in ('tracks', 'centroids', 'attitude', 'attitude_imu', 'image_raw'):
            times = self.times[topic]
            if len(times):
                return int(np.median(times.received_ns - times.stamp_ns))
        return 0


def load_recording(bag: Path, namespace: str | None = None) -> Recording:
    """
    Read a bag folder or file; BagError if it is none. Images are counted, not decoded.

    namespace: of the star tracker, by default the only one in the bag; BagError names them
    if there are several. Of an unfinished or damaged bag what is whole is read, and problems
    say so, as they do of messages that are not what their topic promises.
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
        # A file that is no bag at all fails again, and then for good.
        if tolerant:
            raise
        raise _UnreadableBagError(error) from error
    namespace = _find_namespace(topics) if namespace is None else namespace.strip('/')
    reader = _Reader(namespace)
    messages = read_messages(bag, topics=tuple(reader.handlers), tolerant=tolerant)
    for message in messages if tolerant else _to_the_end(messages):
        reader.take(message)
    return reader.recording(topics, problems, complete=not tolerant)


def _to_the_end(messages: Iterator[BagMessage]) -> Iterator[BagMessage]:
    try:
        yield from messages
    except BagError as error:
        raise _UnreadableBagError(error) from error


def _full_name(namespace: str, topic: str) -> str:
    return f'/{namespace}/{topic}' if namespace else f'/{topic}'


def _find_namespace(topics: Mapping[str, BagTopic]) -> str:
    found = sorted({name.removesuffix(f'/{topic}').strip('/')
                    for name in topics for topic in _TELLING
                    if name.endswith(f'/{topic}') and not name.endswith('/truth/attitude')
                    and not name.endswith('/truth/stars')})
    if len(found) > 1:
        raise BagError(f'the bag holds several star trackers: choose the namespace '
                       f'{", ".join(repr(name) for name in found)}')
    return found[0] if found else ''


class _Reader:
    """Collects what messages say; what cannot be used is counted by topic."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        handlers: dict[str, Callable[[Any, BagMessage], None]] = {
            'camera_info': self._take_camera, 'centroids': self._take_cloud,
            'stars': self._take_cloud, 'tracks': self._take_cloud,
            'attitude': self._take_attitude, 'attitude_cov': self._take_pose,
            'attitude_imu': self._take_imu, 'truth/attitude': self._take_truth,
            'tracker_state': self._take_state}
        # Images are only looked at for their stamps.
        self.handlers = {_full_name(namespace, topic): (topic, type_name, handlers.get(topic))
                         for topic, type_name in TOPIC_TYPES.items()}
        self.handlers[_DIAGNOSTICS] = (
            _DIAGNOSTICS, _DIAGNOSTICS_TYPE, self._take_diagnostics)
        self._problems: dict[str, tuple[int, str]] = {}
        self._times: dict[str, list[tuple[int, int, int]]] = {topic: [] for topic in TOPIC_TYPES}
        self._clouds: dict[str, dict[int, np.ndarray]] = {
            'centroids': {}, 'stars': {}, 'tracks': {}}
        self._camera: Camera | None = None
        self._quaternion: dict[int, np.ndarray] = {}
        self._received: dict[int, int] = {}
        self._covariance: dict[int, np.ndarray] = {}
        self._rate: dict[int, np.ndarray] = {}
        self._without: set[int] = set()
        self._truth: dict[int, np.ndarray] = {}
        self._state: list[tuple[int, str]] = []
        self._diagnostics: list[DiagnosticRecord] = []

    def take(self, message: BagMessage) -> None:
        """Take one message of the topics in handlers."""
        topic, type_name, handler = self.handlers[message.topic]
        try:
            if message.type_name != type_name:
                raise MessageError(f'type {message.type_name!r} is not {type_name}')
            if handler is None:
                self._note_time(topic, _image_stamp_ns(message.data), message)
            else:
                # What is no number shows in the checks of the handlers.
                with np.errstate(all='ignore'):
                    handler(decode(type_name, message.data), message)
        except (BagError, MessageError, CameraError) as error:
            count, first = self._problems.get(message.topic, (0, str(error)))
            self._problems[message.topic] = count + 1, first

    def _stamp_ns(self, decoded: Any, message: BagMessage) -> int:
        stamp = decoded.header.stamp
        stamp_ns = stamp.sec * 10 ** 9 + stamp.nanosec
        self._note_time(self.handlers[message.topic][0], stamp_ns, message)
        return stamp_ns

    def _note_time(self, topic: str, stamp_ns: int, message: BagMessage) -> None:
        received_ns = min(message.log_time_ns, _NEWEST_NS)
        # Recorders that do not know when a message was sent may note 0.
        sent_ns = min(message.publish_time_ns or received_ns, _NEWEST_NS)
        self._times[topic].append((stamp_ns, sent_ns, received_ns))

    def _take_camera(self, decoded: Any, message: BagMessage) -> None:
        self._camera = camera_from_message(decoded)

    def _take_cloud(self, decoded: Any, message: BagMessage) -> None:
        topic = self.handlers[message.topic][0]
        dtype = {'centroids': CENTROID_DTYPE, 'stars': STAR_DTYPE, 'tracks': TRACK_DTYPE}[topic]
        rows = read_cloud(decoded, dtype)
        self._clouds[topic][self._stamp_ns(decoded, message)] = rows

    def _take_attitude(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.quaternion)
        self._note_attitude(self._stamp_ns(decoded, message), quaternion, message)

    def _take_pose(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.pose.pose.orientation)
        stamp_ns = self._stamp_ns(decoded, message)
        self._note_attitude(stamp_ns, quaternion, message)
        block = np.reshape(decoded.pose.covariance, (6, 6))[3:, 3:]
        self._covariance[stamp_ns] = _about_sensor_axes(block, quaternion)

    def _take_imu(self, decoded: Any, message: BagMessage) -> None:
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

    def _note_attitude(self, stamp_ns: int, quaternion: np.ndarray, message: BagMessage) -> None:
        """Keep an attitude; the topic `attitude` has the last word where several tell one."""
        if stamp_ns not in self._quaternion or self.handlers[message.topic][0] == 'attitude':
            self._quaternion[stamp_ns] = quaternion
            self._received[stamp_ns] = min(message.log_time_ns, _NEWEST_NS)

    def _take_truth(self, decoded: Any, message: BagMessage) -> None:
        quaternion = _unit(decoded.quaternion)
        self._truth[self._stamp_ns(decoded, message)] = quaternion

    def _take_state(self, decoded: Any, message: BagMessage) -> None:
        self._state.append((min(message.log_time_ns, _NEWEST_NS), decoded.message))

    def _take_diagnostics(self, decoded: Any, message: BagMessage) -> None:
        stamp = decoded.header.stamp
        self._diagnostics.extend(DiagnosticRecord(
            stamp.sec * 10 ** 9 + stamp.nanosec, min(message.log_time_ns, _NEWEST_NS),
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
            rate_rad_s=_table(self._rate, attitude_ns, (3,)),
            without_attitude_ns=np.array(sorted(self._without - set(attitude_ns)), np.int64),
            truth_ns=np.array(sorted(self._truth), np.int64),
            truth_quaternion=_table(self._truth, sorted(self._truth), (4,)),
            state_ns=np.array([row[0] for row in self._state], np.int64),
            state=tuple(row[1] for row in self._state),
            diagnostics=tuple(self._diagnostics), problems=problems, complete=complete)


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
        raise MessageError(f'quaternion {quaternion.tolist()} is no rotation')
    return quaternion / norm


def _about_sensor_axes(covariance_icrf: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    matrix = matrix_from_quaternion(quaternion)
    covariance = matrix.T @ covariance_icrf @ matrix
    # Beyond a turn nothing is told, whatever the number is.
    told = np.all(np.abs(covariance) < _LARGEST_VARIANCE_RAD2) and np.all(np.diag(covariance) >= 0)
    return covariance if told else np.full((3, 3), np.nan)


def _level(level: bytes | int) -> int:
    """Return the number of a DiagnosticStatus level, which decoders give as byte or number."""
    return level[0] if isinstance(level, bytes) else int(level)


def _image_stamp_ns(cdr: bytes) -> int:
    """Return the stamp of a serialized Image: the first two words after the CDR header."""
    if len(cdr) < 12:
        raise MessageError(f'{len(cdr)} bytes are no image')
    order = '<' if cdr[1] & 1 else '>'
    seconds = int(np.frombuffer(cdr, f'{order}i4', 1, offset=4)[0])
    return seconds * 10 ** 9 + int(np.frombuffer(cdr, f'{order}u4', 1, offset=8)[0])
