# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The golden bags of bags/, replayed: the same centroids, the same stars, the same attitudes.

Made by bags/make.py. A change of the algorithms that moves a figure beyond these tolerances on
purpose makes the bags again.
"""

from collections import defaultdict
from functools import lru_cache
from pathlib import Path
import subprocess
import sys

from chi_square import check_mean
from limits import HANGS_S
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.maths.rotation import attitude_error, matrix_from_quaternion
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.bags.layouts import (
    camera_from_message, image_from_message, ns_from_stamp, read_cloud, STAR_DTYPE)
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.bags.telemetry import rate_from_imu, state_from_odometry
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.clouds import centroids_from_message
from startracker_ros.ros.messages.message_types import message_class

FOLDER = Path(__file__).parents[3] / 'bags'
NAMES = ('slew', 'kidnapped', 'dropouts')

# Of the recorded 1 sigma about each sensor axis: a quarter of what noise does anyway.
ATTITUDE_SIGMAS = 0.25
CENTROID_PX = 0.001
# How many frames earlier or later the tracker may be lost or found.
FRAMES = 1


@lru_cache
def recorded(name: str) -> dict[str, list]:
    """Return the messages of a bag by topic, and all of them in order under ''."""
    topics = defaultdict(list)
    for record in read_messages(FOLDER / name):
        message = deserialize_message(record.data, message_class(record.type_name))
        topics[record.topic].append(message)
        topics[''].append((record.topic, message))
    return topics


def stamp_ns(message: object) -> int:
    return ns_from_stamp(message.header.stamp)


def attitudes(name: str, topic: str) -> dict[int, np.ndarray]:
    return {stamp_ns(message): quaternion_from_message(message)
            for message in recorded(name)[topic]}


def sigmas(name: str) -> dict[int, np.ndarray]:
    """Return the recorded 1 sigma (3,) about sensor axes, rad, by stamp."""
    found = {}
    for message in recorded(name)['/attitude_cov']:
        q = message.pose.pose.orientation
        turn = matrix_from_quaternion([q.x, q.y, q.z, q.w])
        block = np.reshape(message.pose.covariance, (6, 6))[3:, 3:]
        found[stamp_ns(message)] = np.sqrt(np.diag(turn.T @ block @ turn))
    return found


@lru_cache
def replayed(name: str) -> dict[int, FrameResult]:
    """Run the recorded centroids and rates through the cores."""
    topics = recorded(name)
    info = topics['/camera_info'][0]
    pipeline = StarTracker(camera_from_message(info), epoch_year_from_stamp(stamp_ns(info)))
    frames = {}
    for topic, message in topics['']:
        if topic == '/imu':
            pipeline.add_rate(stamp_ns(message), rate_from_imu(message))
        elif topic == '/odometry':
            pipeline.motion.add_state(stamp_ns(message), state_from_odometry(message, 'icrf'))
        elif topic == '/centroids':
            frames[stamp_ns(message)] = pipeline.process_centroids(
                stamp_ns(message), centroids_from_message(message))
    return frames


def test_they_are_small() -> None:
    sizes = {name: sum(file.stat().st_size for file in (FOLDER / name).iterdir())
             for name in NAMES}
    assert max(sizes.values()) <= 3e6
    assert sum(file.stat().st_size for file in FOLDER.rglob('*') if file.is_file()) <= 10e6


@pytest.mark.parametrize('name', NAMES)
def test_rosbags_reads_them(name: str) -> None:
    with Reader(FOLDER / name) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert sum(1 for _ in reader.messages()) == reader.message_count
    assert counts == {topic: len(found) for topic, found in recorded(name).items() if topic}
    frames = 57 if name == 'dropouts' else 60
    assert counts['/image_raw'] == counts['/centroids'] == counts['/attitude_imu'] == frames


@pytest.mark.parametrize('name', NAMES)
def test_images_give_the_same_centroids(name: str) -> None:
    extractor = CentroidExtractor()
    topics = recorded(name)
    for image, cloud in zip(topics['/image_raw'], topics['/centroids'], strict=True):
        again = extractor.measure(image_from_message(image).pixels).centroids
        before = centroids_from_message(cloud)
        assert len(again) == len(before)
        np.testing.assert_allclose(again.uv, before.uv, rtol=0, atol=CENTROID_PX)
        np.testing.assert_allclose(again.flux, before.flux, rtol=0.001)


@pytest.mark.parametrize('name', NAMES)
def test_centroids_give_the_same_attitudes(name: str) -> None:
    before, sigma = attitudes(name, '/attitude'), sigmas(name)
    again = {stamp: frame.attitude.quaternion
             for stamp, frame in replayed(name).items() if frame.attitude is not None}
    assert len(before.keys() ^ again.keys()) <= FRAMES
    for stamp in before.keys() & again.keys():
        assert (np.abs(attitude_error(again[stamp], before[stamp]))
                <= ATTITUDE_SIGMAS * sigma[stamp]).all()


@pytest.mark.parametrize('name', NAMES)
def test_centroids_give_the_same_stars(name: str) -> None:
    for cloud in recorded(name)['/stars']:
        frame = replayed(name)[stamp_ns(cloud)]
        if frame.identification is not None:
            hip = read_cloud(cloud, STAR_DTYPE)['hip']
            assert frame.identification.hip.tolist() == hip.tolist()


@pytest.mark.parametrize('name', NAMES)
def test_no_attitude_is_wrong(name: str) -> None:
    """Neither in the bag nor in the replay, against the truth of the simulation."""
    truth, sigma = attitudes(name, '/truth/attitude'), sigmas(name)
    again = {stamp: frame.attitude.quaternion
             for stamp, frame in replayed(name).items() if frame.attitude is not None}
    for found in (attitudes(name, '/attitude'), again):
        errors = np.array([attitude_error(found[stamp], truth[stamp]) / sigma[stamp]
                           for stamp in found if stamp in sigma])
        assert np.abs(errors).max() < 5
        check_mean(3, np.sum(errors ** 2, axis=1), inflation=2.0)


def frames_with_attitude(name: str) -> set[int]:
    first_ns = stamp_ns(recorded(name)['/image_raw'][0])
    return {(stamp - first_ns) // 10 ** 8 for stamp in attitudes(name, '/attitude')}


def test_the_slew_is_tracked_from_end_to_end() -> None:
    assert frames_with_attitude('slew') == set(range(2, 60))


def test_the_kidnapped_camera_is_lost_and_found() -> None:
    frames = frames_with_attitude('kidnapped')
    assert frames == set(range(2, 30)) | set(range(33, 60))
    states = [message.message for message in recorded('kidnapped')['/tracker_state']]
    assert states == ['ACQUIRING', *['TRACKING'] * 59]


def test_dropouts_are_bridged() -> None:
    frames = frames_with_attitude('dropouts')
    gone = {15, 16, 17, *range(26, 32)}
    assert frames == set(range(2, 60)) - gone
    states = [message.message for message in recorded('dropouts')['/tracker_state']]
    assert set(states[1:]) == {'TRACKING'}


@pytest.mark.slow
def test_they_can_be_made_anew(tmp_path) -> None:
    subprocess.run([sys.executable, FOLDER / 'make.py', tmp_path], check=True, timeout=HANGS_S)
    for name in NAMES:
        made, kept = defaultdict(list), defaultdict(list)
        for folder, topics in ((tmp_path, made), (FOLDER, kept)):
            for record in read_messages(folder / name):
                topics[record.topic].append(record)
        assert made.keys() == kept.keys()
        for topic in ('/image_raw', '/imu', '/odometry', '/truth/attitude', '/centroids'):
            assert [each.log_time_ns for each in made[topic]] == [
                each.log_time_ns for each in kept[topic]]
        attitudes_made = len(made['/attitude'])
        assert abs(attitudes_made - len(kept['/attitude'])) <= 2 * FRAMES
