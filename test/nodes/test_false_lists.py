# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames that cannot be identified: nothing waits for the search, good ones are used at once."""

from functools import partial
import time

from geometry_msgs.msg import QuaternionStamped
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import CAMERA, FRAME, frame, onboard_stars, START_NS
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_pointing, quaternion_from_rotation_vector)
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message

ONBOARD = onboard_stars(CAMERA, 2026.7, 6.5)
NODES = ('star_identifier', 'star_tracker', 'attitude_estimator')
STEP_S = 0.1
# A search for stars in such a list takes a second.
FALSE_STARS, FALSE_FRAMES, GOOD_FRAMES = 150, 60, 30
TURN = quaternion_from_rotation_vector(np.radians([0.05, 0.3, 0.1]) * STEP_S)


class Frames:
    """Lists at a steady rate, and when each was sent and its answers were published."""

    def __init__(self, probe):
        self.probe, self.rng = probe, np.random.default_rng(3)
        self.q = quaternion_from_pointing(*np.radians([84.0, 0.0, 20.0]))
        self.sent_s, self.truth, self.attitudes = {}, {}, {}
        self.answered_s = {}
        for topic, kind in (('stars', PointCloud2), ('tracked_attitude', Imu),
                            ('attitude', QuaternionStamped)):
            self.answered_s[topic] = {}
            probe.subscribe_with_info(kind, topic, partial(self.on_answer, topic), qos.LIST)
        self.centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST, subscribers=2)

    def on_answer(self, topic, message, info):
        stamp_ns = ns_from_stamp(message.header.stamp)
        self.answered_s[topic][stamp_ns] = 1e-9 * info['source_timestamp']
        if topic == 'attitude':
            self.attitudes[stamp_ns] = quaternion_from_message(message)

    def send(self, count, stars):
        """Send lists that stars() returns; return their stamps."""
        stamps_ns, due_s = [], time.monotonic()
        for _ in range(count):
            self.probe.spin_until(lambda due_s=due_s: time.monotonic() >= due_s, STEP_S)
            stamp_ns = START_NS + round(len(self.sent_s) * STEP_S * 1e9)
            self.q = multiply(self.q, TURN)
            self.truth[stamp_ns], self.sent_s[stamp_ns] = self.q, time.time()
            self.centroids.publish(
                centroids_to_message(stars(), CAMERA, make_header(stamp_ns, FRAME)))
            stamps_ns.append(stamp_ns)
            due_s = max(due_s + STEP_S, time.monotonic())
        return stamps_ns

    def false_stars(self):
        return frame(self.rng.uniform(0, 1023, (FALSE_STARS, 2)),
                     flux=self.rng.uniform(1e3, 2e4, FALSE_STARS))

    def good_stars(self):
        return star_list(ONBOARD, CAMERA, self.q, 0.1, self.rng)[0]

    def lags_s(self, topic):
        return [answered_s - self.sent_s[stamp_ns]
                for stamp_ns, answered_s in self.answered_s[topic].items()]


@pytest.mark.parametrize('composed', [False, pytest.param(True, marks=pytest.mark.long)],
                         ids=['processes', 'composed'])
def test_what_cannot_be_identified_holds_up_nothing(nodes, probe, composed):
    if composed:
        nodes.start('composed_pipeline', {}, ['--', *NODES])
    else:
        for name in NODES:
            nodes.start(name)
    frames = Frames(probe)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=3)
    probe.publish_until_received(
        info, camera_to_message(CAMERA, make_header(START_NS, FRAME)), nodes=3)
    # Whatever is built or loaded at the first frame is there afterwards.
    probe.send_until(lambda: frames.send(1, Centroids.empty),
                     lambda: all(frames.answered_s[topic] for topic in (
                         'stars', 'tracked_attitude')), 'an answer of all nodes')
    begun_s = time.monotonic()
    first_ns, *_ = frames.send(FALSE_FRAMES, frames.false_stars)
    good_ns = frames.send(GOOD_FRAMES, frames.good_stars)
    due_ns = {stamp_ns for stamp_ns in frames.sent_s if stamp_ns >= first_ns}
    probe.wait(lambda: due_ns <= set(frames.answered_s['tracked_attitude']) and frames.attitudes,
               'an answer of the tracker to each frame, and an attitude')
    assert not set(frames.attitudes) - set(good_ns)
    assert min(frames.answered_s['attitude'].values()) - frames.sent_s[good_ns[0]] <= 1.0
    for stamp_ns, q in frames.attitudes.items():
        assert np.hypot(*attitude_error(q, frames.truth[stamp_ns])[:2]) < 30 * ARCSEC
    for topic in frames.answered_s:
        assert max(frames.lags_s(topic)) <= 1.0, topic
    for name in NODES:
        assert probe.longest_silence_s(name, begun_s) < 2.0, name
    probe.wait(lambda: all(
        int(probe.diagnostic_value('star_identifier: identification', key) or 0) > 0
        for key in ('time_limit', 'identified')), 'searches that end at the limit, and stars')
    # A signal in the middle of a search: the processes have to end cleanly, as ever.
    frames.send(3, frames.false_stars)
