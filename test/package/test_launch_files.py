"""
The launch files start nodes that exist with parameter files that exist.

The wheels of ROS 2 have no launch package, so its few classes stand here as plain records.
"""

from pathlib import Path
import runpy
import sys
from types import ModuleType

import pytest
from startracker_ros.executables import EXECUTABLES, STAGES

SOURCE = Path(__file__).parents[2]
PIPELINE = ['bag_recorder', *STAGES, 'composed_pipeline']
CLASSES = {
    'launch': ['LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'IncludeLaunchDescription'],
    'launch.conditions': ['IfCondition', 'UnlessCondition'],
    'launch.launch_description_sources': ['PythonLaunchDescriptionSource'],
    'launch.substitutions': ['LaunchConfiguration', 'PathJoinSubstitution'],
    'launch_ros': [],
    'launch_ros.actions': ['Node'],
}


class Record:
    """What a launch class was made with."""

    def __init__(self, value=None, **options):
        self.value, self.options = value, options

    @property
    def name(self):
        return self.value


class Launched:
    """A launch file, executed: its arguments with defaults, its nodes, its inclusions."""

    def __init__(self, path, given=()):
        actions = runpy.run_path(str(path))['generate_launch_description']().value
        of_kind = {kind: [action for action in actions if type(action).__name__ == kind]
                   for kind in ('DeclareLaunchArgument', 'Node', 'IncludeLaunchDescription')}
        assert sum(map(len, of_kind.values())) == len(actions)
        self.arguments = {action.name: action.options['default_value']
                          for action in of_kind['DeclareLaunchArgument']}
        assert set(dict(given)) <= set(self.arguments)
        self.nodes = [action.options for action in of_kind['Node']]
        self.included = [
            Launched(action.value.value, action.options['launch_arguments'])
            for action in of_kind['IncludeLaunchDescription']]

    def text(self, value):
        """Return what a substitution stands for with the default arguments."""
        kind = type(value).__name__
        if kind == 'LaunchConfiguration':
            return self.arguments[value.value]
        if kind == 'PathJoinSubstitution':
            return '/'.join(self.text(part) for part in value.value)
        return value


@pytest.fixture
def launched(monkeypatch, tmp_path):
    for module_name, class_names in CLASSES.items():
        module = ModuleType(module_name)
        for class_name in class_names:
            setattr(module, class_name, type(class_name, (Record,), {}))
        monkeypatch.setitem(sys.modules, module_name, module)
    # An ament prefix whose share folder of the package is the source tree.
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'startracker_ros').touch()
    (tmp_path / 'share' / 'startracker_ros').symlink_to(SOURCE)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
    return lambda name: Launched(SOURCE / 'launch' / name)


def check_nodes(launch):
    for node in launch.nodes:
        assert node['package'] == 'startracker_ros'
        assert node['executable'] in EXECUTABLES
        assert launch.text(node['namespace']) == ''
        files = [Path(launch.text(file)) for file in node['parameters']]
        names = STAGES if node['executable'] == 'composed_pipeline' else [node['executable']]
        assert [file.name for file in files] == [f'{name}.yaml' for name in names]
        assert all(file.is_file() for file in files)
        environment = node['additional_env']
        assert Path(environment['FASTRTPS_DEFAULT_PROFILES_FILE']).is_file()
        assert environment['MALLOC_MMAP_THRESHOLD_'] == str(1 << 30)


def test_pipeline(launched):
    launch = launched('pipeline.launch.py')
    assert [node['executable'] for node in launch.nodes] == PIPELINE
    assert launch.arguments['record'] == launch.arguments['composed'] == 'false'
    conditions = {node['executable']: node['condition'] for node in launch.nodes}
    assert type(conditions['composed_pipeline']).__name__ == 'IfCondition'
    assert {type(conditions[name]).__name__ for name in STAGES} == {'UnlessCondition'}
    assert {conditions[name].value.value for name in (*STAGES, 'composed_pipeline')} == {
        'composed'}
    assert conditions['bag_recorder'].value.value == 'record'
    check_nodes(launch)


def test_demo_is_the_pipeline_under_a_simulated_sky(launched):
    launch = launched('demo.launch.py')
    assert [node['executable'] for node in launch.nodes] == ['sky_simulator']
    assert launch.arguments['record'] == 'true'
    check_nodes(launch)
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
    assert pipeline.arguments.keys() - {'composed'} == launch.arguments.keys()


def test_two_satellites(launched):
    launch = launched('two_satellites.launch.py')
    assert [[node['executable'] for node in each.nodes] for each in launch.included] == [
        PIPELINE, PIPELINE]
    locator, = launch.nodes
    file, names = locator['parameters']
    assert Path(launch.text(file)).resolve() == SOURCE / 'config' / 'target_locator.yaml'
    assert {name: launch.text(value) for name, value in names.items()} == {
        'observer_1': 'tracker_1', 'observer_2': 'tracker_2'}
    assert locator['executable'] in EXECUTABLES


def test_replay_is_the_pipeline_behind_a_bag(launched):
    launch = launched('replay.launch.py')
    player, = launch.nodes
    assert player['executable'] == 'bag_player' in EXECUTABLES
    file, given = player['parameters']
    assert Path(launch.text(file)).name == 'bag_player.yaml' and Path(launch.text(file)).is_file()
    assert launch.text(given['path']) == launch.arguments['bag']
    assert given['topics'] == ['*/image_raw', '*/camera_info', '*/imu']
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
