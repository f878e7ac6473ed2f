# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The launch files start nodes that exist with parameter files that exist.

test/nodes/test_launch_parameters.py starts them.
"""

from pathlib import Path
import sys
from types import SimpleNamespace

from launch_stand_in import install, Launched, SHARED, SOURCE
import pytest
from startracker_ros.ros.executables import EXECUTABLES, STAGES
from startracker_ros.ros.memory import profile_variable

PIPELINE = ['bag_recorder', *STAGES, 'composed_pipeline', 'pipeline_manager']


@pytest.fixture
def launched(monkeypatch, tmp_path):
    install(monkeypatch, tmp_path)
    yield lambda name, **given: Launched(SOURCE / 'launch' / name, given)
    # It holds classes of the modules above.
    sys.modules.pop('startracker_ros.ros.launching', None)


def check_nodes(launch):
    for node in launch.nodes:
        assert node['package'] == 'startracker_ros'
        assert node['executable'] in EXECUTABLES
        assert node['name'] == (None if node['executable'] == 'composed_pipeline'
                                else node['executable'])
        assert launch.text(node['namespace']) == launch.arguments['namespace']
        names = STAGES if node['executable'] == 'composed_pipeline' else [node['executable']]
        level, *files = node['ros_arguments'][1:]
        assert level == launch.arguments['log_level']
        assert files[::2] == ['--params-file'] * len(names)
        assert [Path(file).name for file in files[1::2]] == [f'{name}.yaml' for name in names]
        assert all(Path(file).is_file() for file in files[1::2])
        # Before the dictionary, if there are any.
        assert [given for given in node['parameters'] if not isinstance(given, dict)] == (
            node['parameters'][:1] if launch.arguments['params_file'] else [])
        environment = node['additional_env']
        assert Path(environment[profile_variable()]).is_file()
        assert environment['MALLOC_MMAP_THRESHOLD_'] == str(1 << 30)


def check_end_after_wrong_use(on_exit):
    """Check that a process is not started again after status 2; test/full_install runs launch."""
    for status in (0, 1, -9, -11):
        assert on_exit(SimpleNamespace(returncode=status), None) is None
    message, end = on_exit(SimpleNamespace(
        returncode=2, process_name='star_tracker-3', action='this'), None)
    assert 'star_tracker-3 ended with status 2 and is not started again' in message.options['msg']
    assert type(end.options['event']).__name__ == 'ShutdownProcess'
    assert end.options['event'].options['process_matcher'].value == 'this'


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
        if node.get('respawn'):
            check_end_after_wrong_use(node['on_exit'])
        # The manager brings the stages up, the first time as well.
        assert any('autostart' in given for given in node['parameters']) == stage
    check_nodes(launch)


@pytest.mark.parametrize('name, source, record', [
    ('demo', 'sky_simulator', 'true'), ('camera', 'camera_source', 'false')])
def test_a_source_with_the_pipeline(launched, name, source, record):
    launch = launched(f'{name}.launch.py')
    assert [node['executable'] for node in launch.nodes] == [source]
    check_nodes(launch)
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
    assert pipeline.arguments == {**launch.arguments, 'image_depth': ''}
    assert pipeline.arguments['record'] == record


GIVEN = {'namespace': '/trk', 'params_file': str(SOURCE / 'config' / 'star_tracker.yaml'),
         'log_level': 'debug', 'use_sim_time': 'true', 'composed': 'true', 'manager': 'false'}


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
    assert {name: launch.typed(value) for name, value in locator['parameters'][-1].items()} == {
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
    assert launch.typed(fusion['parameters'][-1]['mounts_file']) == 'mine.yaml'


def test_replay_is_the_pipeline_behind_a_bag(launched):
    launch = launched('replay.launch.py', bag='my_bag', namespace='/trk')
    player, = launch.nodes
    check_nodes(launch)
    given = player['parameters'][-1]
    assert launch.typed(given['path']) == 'my_bag'
    assert given['topics'] == [
        '*/image_raw', '*/image_raw/compressed', '*/camera_info', '*/exposure_start', '*/imu',
        '*/odometry']
    # Relative names are in the namespace of the player, as those of the pipeline.
    assert player['remappings'] == [
        (f'/{topic}', topic) for topic in (
            'image_raw', 'image_raw/compressed', 'camera_info', 'exposure_start', 'imu',
            'odometry')]
    assert given['wait_for_camera_users'] == len(STAGES)
    pipeline, = launch.included
    assert [node['executable'] for node in pipeline.nodes] == PIPELINE
    assert pipeline.arguments['namespace'] == '/trk'


def test_replay_ends_with_the_bag(launched):
    player, = launched('replay.launch.py').nodes
    timer, = player['on_exit']
    assert [type(action).__name__ for action in timer.options['actions']] == ['Shutdown']


def test_what_is_misspelt_is_named_once(launched, monkeypatch, tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text('/trk/star_traker: {ros__parameters: {min_stars: 5}}\n'
                    '/planner: {ros__parameters: {horizon_s: 5.0}}\n'
                    '/**: {ros__parameters: {use_sim_time: true}}\n')
    launch = launched('replay.launch.py', params_file=str(path))
    assert launch.messages == [f'startracker_ros: params_file:={path}: no node star_traker; '
                               'did you mean star_tracker?']
    assert not any(each.messages for each in launch.included)
    # launch itself passes on what no launch file declares.
    monkeypatch.setattr(Launched, 'undeclared', {'startoffset': '5', 'map': 'moon.yaml'})
    assert launched('replay.launch.py').messages == [
        'startracker_ros: startoffset:= is not an argument of this launch file; did you mean '
        'start_offset:=?']


def test_a_file_that_is_not_yaml_is_named(launched, tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text('a: [')
    with pytest.raises(ValueError, match=f'params_file:={path} is not YAML'):
        launched('pipeline.launch.py', params_file=str(path))


@pytest.mark.parametrize('argument', ['config', 'params_file'])
def test_what_is_not_there_is_named(launched, argument):
    with pytest.raises(FileNotFoundError, match=f'{argument}:=/nowhere: no such'):
        launched('pipeline.launch.py', **{argument: '/nowhere'})
