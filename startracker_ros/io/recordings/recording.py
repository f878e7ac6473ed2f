# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a recorded run says about attitude, truth, stars, states and time, as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags.reader import BagTopic, missing

ATTITUDE_TOPICS = ('attitude', 'attitude_cov', 'attitude_imu')
GAP_INTERVALS = 2.5
"""Of the usual interval: frames that are farther apart are not joined in pictures."""


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
    quaternion (N, 4) at attitude_ns (N,); about sensor axes and NaN where not published:
    covariance_sensor (N, 3, 3) in rad^2, protection_rad (N, 3), infinite where there is no bound,
    and rate_rad_s (N, 3);
    without_attitude_ns: frames of which the estimator said that they have none;
    truth_ns (T,), truth_quaternion (T, 4); state_ns and state: the tracker's states, by the
    time they were received; state_sent_ns: when they were sent; problems: what of the bag could
    not be used; complete: whether it could be read to its end.
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
    protection_rad: np.ndarray
    rate_rad_s: np.ndarray
    without_attitude_ns: np.ndarray
    truth_ns: np.ndarray
    truth_quaternion: np.ndarray
    state_ns: np.ndarray
    state_sent_ns: np.ndarray
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
        return full_name(self.namespace, topic)

    def why_nothing(self, *topics: str) -> str:
        """Return why nothing of relative topics was read: not used, or not there."""
        names = [self.full_name(topic) for topic in topics]
        unused = [problem for problem in self.problems if problem.split(': ')[0] in names]
        return '; '.join(unused) or missing(self.topics, dict.fromkeys(names, ''))

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
        """Return 1 sigma (N, 3) of each attitude about sensor axes; NaN where not published."""
        variance = np.diagonal(self.covariance_sensor, axis1=1, axis2=2)
        return np.sqrt(np.where(variance >= 0, variance, np.nan)) / ARCSEC

    def protection_arcsec(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return the protection level (M, 3) of attitudes at stamps (M,)."""
        return self.protection_rad[np.searchsorted(self.attitude_ns, stamps_ns)] / ARCSEC

    def beyond_protection(self) -> tuple[int, int]:
        """Return how many frames of known error have a protection level, and exceed it."""
        stamps, error, _ = self.errors()
        bound = self.protection_arcsec(stamps)
        return (int(np.count_nonzero(~np.isnan(bound).any(axis=1))),
                int(np.count_nonzero((np.abs(error) > bound).any(axis=1))))

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

    @property
    def knows_attitudes(self) -> bool:
        """Whether the bag has a topic of attitudes, with messages or not."""
        return bool(len(self.attitude_ns) or len(self.without_attitude_ns)) or any(
            self.full_name(topic) in self.topics for topic in ATTITUDE_TOPICS)

    def state_frame_ns(self) -> np.ndarray:
        """
        Return the stamps (S,) of the frames of the states, which carry none themselves.

        The tracker sends a state after the tracks of its frame, or after an identification
        between two frames: it is that of the last frame sent before it. A state before all
        frames has the time of its receipt, at most that of the first frame.
        """
        for topic in ('tracks', 'centroids', 'attitude_imu', 'attitude', 'image_raw'):
            times = self.times[topic]
            if len(times):
                order = np.argsort(times.sent_ns, kind='stable')
                before = np.searchsorted(times.sent_ns[order], self.state_sent_ns, 'right') - 1
                return np.where(before >= 0, times.stamp_ns[order][before],
                                np.minimum(self.state_ns, times.stamp_ns.min()))
        return self.state_ns

    def reason_at(self, stamp_ns: int) -> str:
        """Return why a frame has no attitude: by the next status of the estimator, or ''."""
        times = self.times['attitude_imu']
        received_ns = times.received_ns[times.stamp_ns == stamp_ns].min(initial=2 ** 63 - 1)
        status = next((record for record in self.diagnostics if record.received_ns >= received_ns
                       and record.name == 'attitude_estimator: attitude'), None)
        return status.message.partition('no attitude: ')[2] if status else ''


def gaps_after(stamps: np.ndarray, usual: float = GAP_INTERVALS) -> np.ndarray:
    """Return the indices of sorted stamps (N,) that more than so many usual intervals follow."""
    intervals = np.diff(stamps)
    return np.flatnonzero(intervals > usual * np.median(intervals)) if len(
        intervals) else np.empty(0, int)


def full_name(namespace: str, topic: str) -> str:
    """Return the full name of a topic of a star tracker; one with a slash has it already."""
    if topic.startswith('/'):
        return topic
    return f'/{namespace}/{topic}' if namespace else f'/{topic}'


# --- where the attitude must not be interpolated ---

# Fewer frames than this may be missing, as a busy recorder loses them, within one lock.
_UNLOCKED_INTERVALS = 3.0


def lock_segments(recording: Recording) -> np.ndarray:
    """
    Return the number (N,) of the segment of each attitude, from 0; a new one at loss of lock.

    The lock is lost where the estimator says of a frame that it has no attitude
    (attitude_imu); in a bag without that, where the tracker stops TRACKING; and always where
    more than three usual intervals lie between two attitudes, of which nothing is known.
    """
    stamps = recording.attitude_ns
    if not len(stamps):
        return np.zeros(0, int)
    begins = np.zeros(len(stamps) + 1, bool)
    if len(recording.times['attitude_imu']):
        begins[np.searchsorted(stamps, recording.without_attitude_ns)] = True
    else:
        tracking = np.array([state == 'TRACKING' for state in recording.state], bool)
        lost = 1 + np.flatnonzero(tracking[:-1] & ~tracking[1:])
        received = np.maximum.accumulate(recording.attitude_received_ns)
        begins[np.searchsorted(received, recording.state_ns[lost])] = True
    begins[1 + gaps_after(stamps, _UNLOCKED_INTERVALS)] = True
    begins[0] = False
    return np.cumsum(begins[:-1])
