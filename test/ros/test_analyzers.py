# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
diagnostic_analyzers.yaml by the rules of diagnostic_aggregator (branch ros2-jazzy).

A group is in error where one part of it is, or is stale while another is not.
"""

from pathlib import Path
from typing import Any

import pytest
from startracker_ros.ros.executables import NODES, STAGES
import yaml

ANALYZERS = yaml.safe_load((Path(__file__).parents[2] / 'config' / 'diagnostic_analyzers.yaml'
                            ).read_text())['analyzers']['ros__parameters']
OK, WARN, ERROR, STALE = range(4)


def level_of_analyzer(analyzer: dict[str, Any], statuses: dict[str, int]) -> int:
    """Return what GenericAnalyzerBase::report() and GenericAnalyzer::report() make of statuses."""
    expected = analyzer.get('expected', [])
    items = dict.fromkeys(expected, STALE) | {
        name: level for name, level in statuses.items()
        if name in expected or name.startswith(tuple(analyzer['startswith']))}
    discards = analyzer.get('discard_stale', False)
    # One that has timed out is left out, one that is expected and was never received as well.
    levels = [level for level in items.values() if not (discards and level == STALE)]
    if all(level == STALE for level in levels):
        return OK if discards else STALE
    return ERROR if STALE in levels else max(levels)


def level_of_group(group: dict[str, Any], statuses: dict[str, int]) -> int:
    """Return what AnalyzerGroup::report() makes of statuses."""
    levels = [level_of_group(part['analyzers'], statuses) if part['type'].endswith('Group')
              else level_of_analyzer(part, statuses)
              for part in group.values() if isinstance(part, dict)]
    is_stale = max(levels) == STALE and min(levels) < STALE
    return ERROR if is_stale else max(levels)


def statuses_of(*nodes: str) -> dict[str, int]:
    """Return good statuses by their names; tasks of the stages are those of their classes."""
    tasks = {'centroid_extractor': 'centroids', 'star_identifier': 'identification',
             'star_tracker': 'tracking', 'attitude_estimator': 'attitude'}
    return {f'{node}: {tasks.get(node, "task")}': OK for node in nodes}


@pytest.mark.parametrize('beside', [
    ('camera_source', 'pipeline_manager'), ('sky_simulator', 'bag_recorder', 'pipeline_manager'),
    # The driver of somebody else; another manager, or none; both.
    ('pipeline_manager',), ('image_publisher',), ('usb_cam', 'lifecycle_manager'), (), NODES],
    ids=' '.join)
def test_good_statuses_are_good_whatever_is_optional(beside: tuple[str, ...]) -> None:
    assert level_of_group(ANALYZERS, statuses_of(*STAGES, *beside)) == OK


@pytest.mark.parametrize('stage', STAGES)
def test_a_stage_that_is_missing_or_bad_is_an_error(stage: str) -> None:
    others = [node for node in STAGES if node != stage]
    assert level_of_group(ANALYZERS, statuses_of(*others, 'pipeline_manager')) == ERROR
    bad = dict.fromkeys(statuses_of(stage), ERROR)
    assert level_of_group(ANALYZERS, statuses_of(*others) | bad) == ERROR


def test_an_optional_node_that_reports_an_error_is_one() -> None:
    for node in ('camera_source', 'pipeline_manager', 'attitude_fusion'):
        statuses = statuses_of(*STAGES) | dict.fromkeys(statuses_of(node), ERROR)
        assert level_of_group(ANALYZERS, statuses) == ERROR
