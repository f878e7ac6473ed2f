# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two star trackers and a locator, end to end: twelve processes and a bag."""

import json

from commands import invoke
import cv2
from foreign_reader import messages_by_topic, stamp_ns
import numpy as np
import pytest
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud

FRAMES = 20


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    """Run the demo for ten seconds of sky time."""
    output = tmp_path_factory.mktemp('demo') / 'two'
    done = invoke('demo', 'two-satellite', '--seconds', str(FRAMES / 2), '--output', str(output),
                  '--json')
    assert done.exit_code == 0, done.output
    return output, json.loads(done.stdout)


@pytest.fixture(scope='module')
def messages(demo):
    return messages_by_topic(demo[0] / 'bag')


def xyz(vector):
    return np.array([vector.x, vector.y, vector.z])


def test_every_row_holds(demo):
    _, document = demo
    rows = {row['case']: row for row in document['rows']}
    assert all(row['holds'] for row in rows.values()), document
    assert document['conditions']['processes'] == 12
    assert rows['wrong positions']['ours'] == 0


def test_positions_agree_with_the_truth(demo, messages):
    """By rosbags alone; cameras take turns, and the truth of both is one."""
    _, document = demo
    truth = {stamp_ns(m): xyz(m.pose.pose.position)
             for m in messages['/tracker_1/truth/target']}
    other = messages['/tracker_2/truth/target']
    assert len(truth) == FRAMES and not truth.keys() & {stamp_ns(m) for m in other}
    before = max(ns for ns in truth if ns < stamp_ns(other[5]))
    step_s = (stamp_ns(other[5]) - before) * 1e-9
    expected = truth[before] + step_s * xyz(other[5].twist.twist.linear)
    assert np.linalg.norm(xyz(other[5].pose.pose.position) - expected) < 1.0
    positions = messages['/target/position']
    assert len(positions) >= FRAMES / 2
    errors = [np.linalg.norm(xyz(m.pose.pose.position) - truth[stamp_ns(m)]) for m in positions]
    printed = {row['case']: row['ours'] for row in document['rows']}
    assert printed['error of the position, rms'] == pytest.approx(
        np.sqrt(np.mean(np.square(errors))), rel=1e-6)
    assert max(errors) < 100
    lines = messages['/target/line_of_sight']
    assert [stamp_ns(m.markers[0]) for m in lines] == [stamp_ns(m) for m in positions]


def test_the_target_is_found_in_images_that_are_not_searched_as_a_whole(messages):
    for name in ('tracker_1', 'tracker_2'):
        windowed = {stamp_ns(m) for m in messages[f'/{name}/centroids']
                    if read_cloud(m, CENTROID_DTYPE)['directed'].any()}
        found = {stamp_ns(m) for m in messages[f'/{name}/target_centroid'] if m.width}
        assert len(windowed & found) >= 3


def test_the_picture_marks_the_target(demo):
    output, _ = demo
    blue, green, red = np.moveaxis(
        cv2.imread(str(output / 'two_satellite.png')).astype(int), -1, 0)
    assert np.count_nonzero((red > 200) & (green < 60) & (blue < 60)) > 50
    # The circles around the stars, drawn smaller than they are.
    assert np.count_nonzero((green > red + 30) & (green > blue + 15)) > 1000
