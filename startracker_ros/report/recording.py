"""What a recorded run says about attitude, truth and time, as arrays."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from startracker_ros.bag.reader import decode, read_messages
from startracker_ros.rotation import ARCSEC, attitude_error, matrix_from_quaternion


@dataclass(frozen=True)
class Recording:
    """One star tracker's run; stamps are int64 ns since the UNIX epoch, sorted.

    image_ns and image_sent_ns (F,): stamp of each image and when it was sent;
    centroids_ns: stamps of the frames that were extracted;
    attitude_ns (N,), quaternion (N, 4), covariance_sensor (N, 3, 3) in rad^2,
    attitude_received_ns (N,): the attitudes and when the recorder got them;
    truth_ns (T,), truth_quaternion (T, 4); state_ns and state: the tracker's states.
    """

    image_ns: np.ndarray
    image_sent_ns: np.ndarray
    centroids_ns: np.ndarray
    attitude_ns: np.ndarray
    attitude_received_ns: np.ndarray
    quaternion: np.ndarray
    covariance_sensor: np.ndarray
    truth_ns: np.ndarray
    truth_quaternion: np.ndarray
    state_ns: np.ndarray
    state: tuple[str, ...]

    def errors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return stamps (M,), errors (M, 3) and sigmas (M, 3) in arcsec about sensor axes.

        Only frames that have both an attitude and a truth with the same stamp.
        """
        stamps, ours, truth = np.intersect1d(self.attitude_ns, self.truth_ns,
                                             return_indices=True)
        error = attitude_error(self.quaternion[ours], self.truth_quaternion[truth])
        sigma = np.sqrt(np.diagonal(self.covariance_sensor[ours], axis1=1, axis2=2))
        return stamps, error / ARCSEC, sigma / ARCSEC

    def latency_ms(self) -> np.ndarray:
        """Return the time from sending an image to receiving its attitude, each frame (M,)."""
        _, image, ours = np.intersect1d(self.image_ns, self.attitude_ns, return_indices=True)
        return (self.attitude_received_ns[ours] - self.image_sent_ns[image]) / 1e6


def _stamp_ns(message: object) -> int:
    return message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec


def _xyzw(q: object) -> list[float]:
    return [q.x, q.y, q.z, q.w]


def load_recording(bag: Path, namespace: str = '') -> Recording:
    """Read a bag folder or file; BagError if it is none. Images are counted, not decoded."""
    prefix = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    wanted = {f'{prefix}/{topic}': topic for topic in (
        'camera_info', 'image_raw', 'centroids', 'attitude', 'attitude_cov', 'truth/attitude',
        'tracker_state')}
    images, centroids, attitudes, covariances, truth, states = [], [], [], {}, [], []
    for record in read_messages(bag, topics=tuple(wanted)):
        topic = wanted[record.topic]
        if topic == 'image_raw':
            images.append((_image_stamp_ns(record.data), record.publish_time_ns))
            continue
        message = decode(record.type_name, record.data)
        if topic == 'centroids':
            centroids.append(_stamp_ns(message))
        elif topic == 'attitude':
            attitudes.append((_stamp_ns(message), record.log_time_ns,
                              _xyzw(message.quaternion)))
        elif topic == 'attitude_cov':
            block = np.reshape(message.pose.covariance, (6, 6))[3:, 3:]
            matrix = matrix_from_quaternion(_xyzw(message.pose.pose.orientation))
            covariances[_stamp_ns(message)] = matrix.T @ block @ matrix
        elif topic == 'truth/attitude':
            truth.append((_stamp_ns(message), _xyzw(message.quaternion)))
        elif topic == 'tracker_state':
            states.append((record.log_time_ns, message.message))
    unknown = np.full((3, 3), np.nan)
    attitudes.sort(key=lambda row: row[0])
    truth.sort(key=lambda row: row[0])
    images.sort()
    return Recording(
        image_ns=np.array([row[0] for row in images], np.int64),
        image_sent_ns=np.array([row[1] for row in images], np.int64),
        centroids_ns=np.array(sorted(centroids), np.int64),
        attitude_ns=np.array([row[0] for row in attitudes], np.int64),
        attitude_received_ns=np.array([row[1] for row in attitudes], np.int64),
        quaternion=np.array([row[2] for row in attitudes], float).reshape(-1, 4),
        covariance_sensor=np.array([covariances.get(row[0], unknown) for row in attitudes]
                                   ).reshape(-1, 3, 3),
        truth_ns=np.array([row[0] for row in truth], np.int64),
        truth_quaternion=np.array([row[1] for row in truth], float).reshape(-1, 4),
        state_ns=np.array([row[0] for row in states], np.int64),
        state=tuple(row[1] for row in states))


def _image_stamp_ns(cdr: bytes) -> int:
    """Return the stamp of a serialized Image: the first two words after the CDR header."""
    order = '<' if cdr[1] & 1 else '>'
    seconds, nanoseconds = np.frombuffer(cdr, f'{order}u4', 2, offset=4)
    return int(seconds) * 10 ** 9 + int(nanoseconds)
