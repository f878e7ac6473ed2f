# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the diagnostics as diagnostic_aggregator expects them, and its configuration."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from startracker_ros.ros.executables import NODES, STAGES
import yaml

ROOT = Path(__file__).parents[2]
ANALYZERS = ROOT / 'config' / 'diagnostic_analyzers.yaml'


def analyzers(group):
    """Return all GenericAnalyzers of a group, those of its groups included."""
    found = []
    for value in group.values():
        if isinstance(value, dict):
            found += analyzers(value['analyzers']) if value['type'].endswith('Group') else [value]
    return found


def is_match(analyzer, name):
    """Return whether a GenericAnalyzer has a status, as diagnostic_aggregator documents it."""
    assert analyzer.keys() <= {'type', 'path', 'expected', 'startswith', 'discard_stale'}
    assert analyzer['type'] == 'diagnostic_aggregator/GenericAnalyzer'
    return name in analyzer.get('expected', []) or name.startswith(tuple(analyzer['startswith']))


@pytest.fixture
def started(nodes, tmp_path):
    """Start every node there is."""
    cv2.imwrite(str(tmp_path / 'stars.png'), np.zeros((64, 64), np.uint8))
    own = {'image_publisher': {'path': str(tmp_path / 'stars.png'), 'wait_for_subscribers': 9},
           'sky_simulator': {'autostart': False},
           'bag_player': {'path': str(ROOT / 'bags' / 'slew'), 'start_paused': True},
           'bag_recorder': {'folder': str(tmp_path / 'bag')}}
    for node in NODES:
        nodes.start(node, own.get(node))


def test_each_status_is_in_one_group_and_each_expected_one_is_published(started, probe):
    groups = analyzers(yaml.safe_load(ANALYZERS.read_text())['analyzers']['ros__parameters'])

    def names():
        return {status.name for status in probe.statuses()}
    topics = {'centroid_extractor': 'image_raw', 'star_identifier': 'centroids',
              'star_tracker': 'centroids', 'attitude_estimator': 'tracks'}
    wanted = {f'{node}: {topic} topic status' for node, topic in topics.items()}
    assert topics.keys() == set(STAGES)

    def all_are_there():
        return wanted <= names() and {name.split(':')[0] for name in names()} == set(NODES)
    probe.wait(all_are_there, 'a status of every node')
    assert all(sum(is_match(group, name) for group in groups) == 1 for name in names()), names()
    assert {name for group in groups for name in group.get('expected', [])} <= names()
    assert all(status.hardware_id == 'star_tracker' for status in probe.statuses())
    assert len(names()) == len(NODES) + len(STAGES)


def test_names_of_several_trackers_differ_with_use_fqn(nodes, probe):
    for namespace, parameters in (('one', {'diagnostic_updater.use_fqn': True}), ('two', {})):
        nodes.start('target_locator', parameters, namespace=namespace)
    probe.wait(lambda: {(s.name, s.hardware_id) for s in probe.statuses()} == {
        ('/one/target_locator: location', 'one'), ('target_locator: location', 'two')},
        'both names')
