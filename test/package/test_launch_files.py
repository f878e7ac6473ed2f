"""
The launch files start nodes that exist with parameter files that exist.

The wheels of ROS 2 have no launch package, so its few classes stand here as plain records.
"""

import os
from pathlib import Path
import runpy
import sys
from types import ModuleType

import pytest
from startracker_ros.executables import EXECUTABLES, STAGES

SOURCE = Path(__file__).parents[2]
PIPELINE = ['bag_recorder', *STAGES, 'composed_pipeline', 'pipeline_manager']
SHARED = {'namespace', 'config', 'params_file', 'log_level', 'use_sim_time', 'composed', 'manager'}
CLASSES = {
    'launch': ['LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'GroupAction', 'IncludeLaunchDescription'],
    'launch.conditions': ['IfCondition', 'UnlessCondition'],
    'launch.launch_description_sources': ['PythonLaunchDescriptionSource'],
    'launch.substitutions': ['IfElseSubstitution', 'LaunchConfiguration', 'NotEqualsSubstitution',
                             'PathJoinSubstitution'],
    'launch_ros': [],
    'launch_ros.actions': ['Node'],
}


class Record:
    """What a launch class was made with."""

    def __init__(self, *values, **options):
        self.values, self.options = values, options

    @property
    def value(self):
        return self.values[0]

    @property
    def name(self):
        return self.value


class Launched:
    """A launch file, executed: its arguments, its nodes, its inclusions."""

    def __init__(self, path, given):
        actions = runpy.run_path(str(path))['generate_launch_description']().value
        of_kind = {kind: [action for action in actions if type(action).__name__ == kind]
                   for kind in ('DeclareLaunchArgument', 'Node', 'GroupAction')}
        assert sum(map(len, of_kind.values())) == len(actions)
        self.arguments = {action.name: action.options['default_value']
                          for action in of_kind['DeclareLaunchArgument']}
        assert given.keys() <= self.arguments.keys()
        self.arguments |= given
        assert self.arguments.keys() >= SHARED
        self.nodes = [action.options for action in of_kind['Node']]
        # Each in a group of its own: its arguments would remain for what comes after.
        includes = [action.value[0] for action in of_kind['GroupAction']]
        self.included = [
            Launched(include.value.value, {
                name: self.text(value) for name, value in include.options['launch_arguments']})
            for include in includes]

    def text(self, value):
        """Return what a substitution stands for with these arguments."""
        kind = type(value).__name__
        if kind == 'LaunchConfiguration':
            return self.arguments[value.value]
        if kind == 'PathJoinSubstitution':
            return os.path.join(*map(self.text, value.value))
        if isinstance(value, tuple):
            return ''.join(map(self.text, value))
        if kind == 'NotEqualsSubstitution':
            return self.text(value.values[0]) != self.text(value.values[1])
        if kind == 'IfElseSubstitution':
            return self.text(value.values[1 if self.text(value.values[0]) else 2])
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
    yield lambda name, **given: Launched(SOURCE / 'launch' / name, given)
    # It holds classes of the modules above.
    sys.modules.pop('startracker_ros.harness.launching', None)


def check_nodes(launch):
    for node in launch.nodes:
        assert node['package'] == 'startracker_ros'
        assert node['executable'] in EXECUTABLES
        assert node['name'] == (None if node['executable'] == 'composed_pipeline'
                                else node['executable'])
        assert launch.text(node['namespace']) == launch.arguments['namespace']
        assert [launch.text(word) for word in node['ros_arguments']] == [
            '--log-level', launch.arguments['log_level']]
        time, *files = node['parameters']
        assert {name: launch.text(value) for name, value in time.items()} == {
            'use_sim_time': launch.arguments['use_sim_time']}
        files = [Path(launch.text(file)) for file in files if not isinstance(file, dict)]
        names = STAGES if node['executable'] == 'composed_pipeline' else [node['executable']]
        given = launch.arguments['params_file']
        assert [file.name for file in files] == [
            *(f'{name}.yaml' for name in names), given or f'{names[-1]}.yaml']
        assert all(file.is_file() for file in files if str(file) != given)
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
    assert conditions['pipeline_manager'].value.value == 'manager'
    for node in launch.nodes:
        stage = node['executable'] in (*STAGES, 'composed_pipeline')
        # A recorder that is started again would begin a bag nobody asked for.
        assert node.get('respawn', False) == (node['executable'] != 'bag_recorder')
        # The manager brings the stages up, the first time as well.
        assert ({'autostart': False} in node['parameters']) == stage
    check_nodes(launch)


@pytest.mark.parametrize('name, source, record', [
    ('demo', 'sky_simulator', 'true'), ('camera', 'camera_source', 'false')])
def test_a_source_with_the_pipeline(launched, name, source, record):
    launch = launched(f'{name}.launch.py')
    assert [node['executable'] for node in launch.nodes] == [source]
    check_nodes(launch)
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
    assert pipeline.arguments == {**launch.arguments, 'image_depth': '10'}
    assert pipeline.arguments['record'] == record


GIVEN = {'namespace': '/trk', 'params_file': 'mine.yaml', 'log_level': 'debug',
         'use_sim_time': 'true', 'composed': 'true', 'manager': 'false'}


@pytest.mark.parametrize('name', ['camera', 'demo', 'heads', 'replay', 'two_satellites'])
def test_the_shared_arguments_reach_all_nodes(launched, name):
    launch = launched(f'{name}.launch.py', **GIVEN)
    check_nodes(launch)
    for pipeline in launch.included:
        check_nodes(pipeline)
        for argument in SHARED - {'namespace'}:
            assert pipeline.arguments[argument] == launch.arguments[argument]
        assert pipeline.arguments['namespace'].startswith('/trk')


def test_two_satellites(launched):
    launch = launched('two_satellites.launch.py')
    assert [[node['executable'] for node in each.nodes] for each in launch.included] == [
        PIPELINE, PIPELINE]
    locator, = launch.nodes
    check_nodes(launch)
    assert {name: launch.text(value) for name, value in locator['parameters'][-1].items()} == {
        'observer_1': 'tracker_1', 'observer_2': 'tracker_2'}
    for namespace, before in ('', ''), ('/formation', '/formation/'):
        launch = launched('two_satellites.launch.py', namespace=namespace)
        assert [pipeline.arguments['namespace'] for pipeline in launch.included] == [
            f'{before}tracker_1', f'{before}tracker_2']


def test_heads(launched):
    launch = launched('heads.launch.py', mounts_file='mine.yaml')
    assert [pipeline.arguments['namespace'] for pipeline in launch.included] == [
        'tracker_1', 'tracker_2']
    fusion, = launch.nodes
    check_nodes(launch)
    assert launch.text(fusion['parameters'][-1]['mounts_file']) == 'mine.yaml'


def test_replay_is_the_pipeline_behind_a_bag(launched):
    launch = launched('replay.launch.py', bag='my_bag', namespace='/trk')
    player, = launch.nodes
    check_nodes(launch)
    given = player['parameters'][-1]
    assert launch.text(given['path']) == 'my_bag'
    assert given['topics'] == [
        '*/image_raw', '*/image_raw/compressed', '*/camera_info', '*/imu', '*/odometry']
    # Relative names are in the namespace of the player, as those of the pipeline.
    assert player['remappings'] == [
        (f'/{topic}', topic) for topic in (
            'image_raw', 'image_raw/compressed', 'camera_info', 'imu', 'odometry')]
    assert given['wait_for_camera_users'] == len(STAGES)
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
    assert pipeline.arguments['namespace'] == '/trk'
    expected = {'qos_overrides./trk/image_raw.subscription.depth': '100'}
    for node in pipeline.nodes:
        depths = {pipeline.text(name): pipeline.text(value)
                  for given in node['parameters'][1:] if isinstance(given, dict)
                  for name, value in given.items() if name != 'autostart'}
        assert depths == (expected if node['executable'] in (*STAGES, 'composed_pipeline')
                          else {})
