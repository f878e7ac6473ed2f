# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameter files match the code."""

from pathlib import Path

import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter as RclpyParameter
from startracker_ros.ros import tables
from startracker_ros.ros.executables import NODES
import yaml

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize('path', tables.files(ROOT))
def test_generated_files_are_current(path):
    assert (ROOT / path).read_text() == tables.files(ROOT)[path], (
        'run python -m startracker_ros.ros.tables')


@pytest.mark.parametrize('node', NODES)
def test_every_name_stands_once_and_yaml_holds_the_defaults(node):
    rows = tables.node_rows(node)
    assert len({row.name for row in rows}) == len(rows)
    parameters = yaml.safe_load(tables.yaml_text(node))[f'/**/{node}']['ros__parameters']
    assert parameters == {row.name: list(row.default) if isinstance(row.default, tuple)
                          else row.default for row in rows}


def test_a_node_starts_with_its_own_yaml(nodes, probe):
    nodes.start('centroid_extractor', extra=[
        '--ros-args', '--params-file', str(ROOT / 'config' / 'centroid_extractor.yaml')])
    probe.wait(lambda: probe.count_publishers('centroids'), 'the node')


def test_the_values_that_a_node_has_do_not_change_it(nodes, probe, tmp_path):
    """As `ros2 param load` of the node's own `ros2 param dump` sets them, one by one."""
    nodes.start('star_tracker')
    log = tmp_path / 'star_tracker.log'
    probe.wait(lambda: log.exists() and 'ready' in log.read_text(), 'the node')
    names = probe.call(ListParameters, '/star_tracker/list_parameters',
                       ListParameters.Request()).result.names
    values = probe.call(GetParameters, '/star_tracker/get_parameters',
                        GetParameters.Request(names=names)).values
    assert {row.name for row in tables.node_rows('star_tracker')} <= set(names)
    dump = [Parameter(name=name, value=value) for name, value in zip(names, values)]

    def set_parameters(*parameters):
        return probe.call(SetParameters, '/star_tracker/set_parameters',
                          SetParameters.Request(parameters=parameters)).results
    assert [result.reason for result in set_parameters(*dump) if not result.successful] == []
    assert 'parameters changed' not in log.read_text()
    misspelt, = set_parameters(RclpyParameter('magnitud_limit', value=5.5).to_parameter_msg())
    assert misspelt.reason == 'unknown parameter magnitud_limit; did you mean magnitude_limit?'
    limit = RclpyParameter('magnitude_limit', value=5.5).to_parameter_msg()
    assert all(result.successful for result in set_parameters(limit, limit))
    # The call may be repeated: still one change.
    assert log.read_text().count('parameters changed: magnitude_limit = 5.5') == 1
