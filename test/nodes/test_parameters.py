"""Parameter files match the code."""

from pathlib import Path

import pytest
from startracker_ros.executables import NODES
from startracker_ros.ros import tables
import yaml

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize('path', tables.files())
def test_generated_files_are_current(path):
    assert (ROOT / path).read_text() == tables.files()[path], (
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
