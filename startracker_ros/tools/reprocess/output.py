# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results of the pipeline as the messages that the nodes publish, in a bag."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from startracker_ros.core.attitude.result import AttitudeEstimate, covariance_icrf
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.cloud_rows import (
    centroid_rows, star_rows, STATE_NAME, track_rows, tracker_state_values)
from startracker_ros.io.bags.layouts import INERTIAL_FRAME_ID
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.io.recordings.recording import full_name

TOPICS = {
    'camera_info': cdr.CAMERA_INFO, 'centroids': cdr.POINT_CLOUD, 'stars': cdr.POINT_CLOUD,
    'tracked_attitude': cdr.IMU, 'tracks': cdr.POINT_CLOUD, 'tracker_state': cdr.STATUS,
    'attitude': cdr.QUATERNION, 'attitude_cov': cdr.POSE, 'attitude_transform': cdr.TRANSFORM,
    'attitude_imu': cdr.IMU, 'protection_level': cdr.VECTOR}
_OK, _WARN = 0, 1


def chosen_topics(patterns: Sequence[str]) -> frozenset[str]:
    """Return the topics of TOPICS that match a pattern with *."""
    return frozenset(topic for topic in TOPICS
                     if any(fnmatchcase(topic, pattern) for pattern in patterns))


class SegmentBag:
    """
    The bag of one segment: one file, with the stamps as times of sending and of recording.

    The ids of tracks begin at first_track_id, so that those of segments differ.
    """

    def __init__(self, folder: Path, namespace: str, topics: frozenset[str],
                 first_track_id: int) -> None:
        self._writer = BagWriter(folder, flush_ns=0)
        self._names = {topic: full_name(namespace, topic) for topic in TOPICS if topic in topics}
        self._hardware_id = namespace
        self._first_track_id = first_track_id
        self._camera: Camera | None = None
        for topic, name in self._names.items():
            durable = 'transient_local' if topic == 'tracker_state' else 'volatile'
            self._writer.add_topic(name, TOPICS[topic], (QosProfile(durability=durable),))

    def close(self) -> None:
        """Write index and metadata; BagError if that fails."""
        self._writer.close()

    def write(self, stamp_ns: int, frame_id: str, camera: Camera, centroids: Centroids,
              extracted: bool, frame: FrameResult, pipeline: StarTracker) -> None:
        """Write what the nodes publish of a frame; centroids where they were extracted here."""
        def send(topic: str, data: bytes) -> None:
            self._writer.write(self._names[topic], data, stamp_ns, stamp_ns)

        def sends(topic: str) -> bool:
            return topic in self._names
        if sends('camera_info') and not camera.is_same(self._camera):
            send('camera_info', cdr.camera_info(stamp_ns, frame_id, camera))
            self._camera = camera
        if sends('centroids') and extracted:
            send('centroids', cdr.point_cloud(stamp_ns, frame_id, centroid_rows(
                centroids, camera, pipeline.extraction.windowed)))
        found = frame.identification
        if sends('stars') and found is not None and len(found.hip) == len(centroids):
            send('stars', cdr.point_cloud(stamp_ns, frame_id, star_rows(
                centroids, found.hip, found.magnitude, found.residual_px, camera)))
        if sends('tracked_attitude'):
            tracked = frame.tracked.attitude if frame.tracked else None
            send('tracked_attitude', _imu(stamp_ns, frame_id, frame, tracked, _on_icrf(tracked)))
        if sends('tracks'):
            rows = track_rows(frame.tracks, camera)
            rows['track_id'] += np.uint32(self._first_track_id)
            send('tracks', cdr.point_cloud(stamp_ns, frame_id, rows))
        if sends('tracker_state'):
            send('tracker_state', self._state(frame, pipeline))
        attitude = frame.attitude
        covariance = _on_icrf(attitude)
        if attitude is not None:
            q = attitude.quaternion
            if sends('attitude'):
                send('attitude', cdr.quaternion_stamped(stamp_ns, INERTIAL_FRAME_ID, q))
            if sends('attitude_cov'):
                send('attitude_cov', cdr.pose_stamped(stamp_ns, INERTIAL_FRAME_ID, q, covariance))
            if sends('protection_level'):
                send('protection_level', cdr.vector_stamped(
                    stamp_ns, frame_id, attitude.protection_rad))
            if sends('attitude_transform'):
                send('attitude_transform', cdr.transform(stamp_ns, INERTIAL_FRAME_ID, frame_id, q))
        if sends('attitude_imu'):
            send('attitude_imu', _imu(stamp_ns, frame_id, frame, attitude, covariance))

    def _state(self, frame: FrameResult, pipeline: StarTracker) -> bytes:
        """Return `tracker_state`."""
        level = _OK if frame.state is TrackerState.TRACKING else _WARN
        return cdr.status(level, STATE_NAME, frame.state.value, self._hardware_id,
                          tracker_state_values(pipeline.tracker))


def _on_icrf(attitude: AttitudeEstimate | None) -> np.ndarray:
    """Return the covariance (3, 3) on ICRF axes of an attitude, zeros without."""
    return np.zeros((3, 3)) if attitude is None else covariance_icrf(
        attitude.quaternion, attitude.covariance_sensor)


def _imu(stamp_ns: int, frame_id: str, frame: FrameResult, attitude: AttitudeEstimate | None,
         covariance: np.ndarray) -> bytes:
    """Return an Imu of an attitude with the tracked rate, or one that is marked as unknown."""
    if attitude is None:
        return cdr.imu(stamp_ns, frame_id, None, None)
    if frame.tracked is None:
        return cdr.imu(stamp_ns, frame_id, attitude.quaternion, covariance)
    return cdr.imu(stamp_ns, frame_id, attitude.quaternion, covariance,
                   frame.tracked.rate_rad_s, frame.tracked.rate_covariance)
