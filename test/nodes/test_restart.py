# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A jump back in time is one restart, whatever the queues of the topics still hold."""

from builtin_interfaces.msg import Time
import pytest
import rclpy
from startracker_ros.ros.nodes.star_tracker import StarTrackerNode


@pytest.fixture
def tracker(monkeypatch):
    """Return a star tracker whose rebuilds are counted."""
    rclpy.init()
    node = StarTrackerNode()
    node.rebuilds = 0

    def count():
        node.rebuilds += 1
    monkeypatch.setattr(node, 'rebuild', count)
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_messages_from_before_the_restart_are_not_another_restart(tracker):
    for sec in range(1, 7):
        assert tracker.in_order('imu', Time(sec=sec))
        assert tracker.in_order('centroids', Time(sec=sec))
    assert tracker.in_order('centroids', Time(sec=1))
    assert tracker.rebuilds == 1
    # The last rates and identified stars before the restart come after the first centroids.
    assert not tracker.in_order('imu', Time(sec=7))
    assert not tracker.in_order('stars', Time(sec=6))
    for topic in ('imu', 'stars', 'imu', 'stars'):
        tracker.in_order(topic, Time(sec=1))
    assert tracker.in_order('imu', Time(sec=1, nanosec=500_000_000))
    assert tracker.in_order('stars', Time(sec=2))
    assert tracker.rebuilds == 1
    counts = tracker.diagnostics.counts
    assert counts['imu from before the restart'] == counts['stars from before the restart'] == 1
    # The next round of a looped bag.
    assert tracker.in_order('centroids', Time(sec=6))
    assert tracker.in_order('imu', Time(sec=6))
    assert tracker.in_order('imu', Time(sec=1))
    assert not tracker.in_order('centroids', Time(sec=7))
    assert tracker.in_order('centroids', Time(sec=1))
    assert tracker.rebuilds == 2


def test_a_topic_that_runs_ahead_is_used_when_the_others_get_there(tracker):
    assert tracker.in_order('centroids', Time(sec=10))
    assert tracker.in_order('centroids', Time(sec=1))
    assert not tracker.in_order('imu', Time(sec=4))
    assert tracker.in_order('centroids', Time(sec=3))
    assert tracker.in_order('imu', Time(sec=4))
    assert tracker.rebuilds == 1
