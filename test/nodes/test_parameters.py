"""Parameter files match the code; changes at run time take effect or are refused."""

from pathlib import Path

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
import pytest
from std_srvs.srv import Trigger
import yaml

from startracker_ros.executables import NODES
from startracker_ros.ros import tables

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize('path', tables.files())
def test_generated_files_are_current(path):
    assert (ROOT / path).read_text() == tables.files()[path], (
        'run python -m startracker_ros.ros.tables')


@pytest.mark.parametrize('node', NODES)
def test_every_name_stands_once_and_yaml_holds_the_defaults(node):
    rows = tables.node_rows(node)
    assert len({row.name for row in rows}) == len(rows)
    parameters = yaml.safe_load(tables.yaml_text(node))['/**']['ros__parameters']
    assert parameters == {row.name: list(row.default) if isinstance(row.default, tuple)
                          else row.default for row in rows}


def test_a_node_starts_with_its_own_yaml(nodes, probe):
    nodes.start('centroid_extractor', extra=[
        '--ros-args', '--params-file', str(ROOT / 'config' / 'centroid_extractor.yaml')])
    probe.wait(lambda: probe.count_publishers('centroids'), 'the node')


def set_double(probe, node, name, value):
    request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(
        type=ParameterType.PARAMETER_DOUBLE, double_value=value))])
    return probe.ask(SetParameters, f'/{node}/set_parameters', request).results[0]


def test_changes_at_run_time(nodes, probe):
    nodes.start('attitude_estimator')
    assert set_double(probe, 'attitude_estimator', 'max_residual_px', 2.0).successful
    refused = set_double(probe, 'attitude_estimator', 'max_residual_px', -2.0)
    assert not refused.successful
    assert 'max_residual_px' in refused.reason and '0.01' in refused.reason


@pytest.mark.parametrize('node', ['star_identifier', 'star_tracker', 'attitude_estimator'])
def test_reset_is_offered(nodes, probe, node):
    nodes.start(node)
    answer = probe.ask(Trigger, f'/{node}/reset', Trigger.Request())
    assert answer.success and answer.message == 'state forgotten'
