# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The arguments of the launch files reach the parameters of running nodes.

Files and arguments are those of launch_ros (test/launch_stand_in.py); ROS merges them.
"""

import json
import sys

from launch_stand_in import install, Launched, SOURCE
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.processes import node_command

DEPTH = 'qos_overrides./trk/image_raw.subscription.depth'
KEYS = ['/trk/star_tracker', '/**/star_tracker', '/**']


@pytest.fixture
def started(monkeypatch, tmp_path, nodes, probe):
    """Return a function that starts a node of a launch file and reads its parameters."""
    install(monkeypatch, tmp_path)

    def start(launch, executable, node, names, set_parameters=()):
        chosen, = (each for each in launch.nodes if each['executable'] == executable)
        nodes.environment.update(chosen['additional_env'])
        nodes.run(executable, node_command(executable, launch.ros_arguments(
            chosen, tmp_path, set_parameters)))
        values = probe.call(GetParameters, f'{node}/get_parameters',
                            GetParameters.Request(names=names)).values
        return {name: parameter_value_to_python(value) for name, value in zip(names, values)}
    yield start
    sys.modules.pop('startracker_ros.ros.launching', None)


def launch_file(name, **given):
    return Launched(SOURCE / 'launch' / f'{name}.launch.py', {'namespace': 'trk', **given})


@pytest.fixture
def mine(tmp_path):
    """Return a function that writes a params_file with one key."""
    def write(key, **parameters):
        path = tmp_path / 'mine.yaml'
        path.write_text(f'{key}:\n  ros__parameters: {json.dumps(parameters)}\n')
        return str(path)
    return write


@pytest.mark.parametrize('composed', [False, True])
@pytest.mark.parametrize('key', KEYS)
def test_the_file_of_the_user_wins_and_the_arguments_last(
        started, mine, tmp_path, key, composed):
    launch = launch_file('pipeline', image_depth='7', use_sim_time='true', params_file=mine(
        key, min_stars=6, autostart=True, use_sim_time=False))
    executable = 'composed_pipeline' if composed else 'star_tracker'
    values = started(launch, executable, '/trk/star_tracker', [
        'min_stars', 'autostart', 'use_sim_time', 'max_stars'])
    assert values['min_stars'] == 6 and values['max_stars'] == 40
    # A composed process has one dictionary for all its nodes: a file that names one of them
    # with its namespace is met first, the arguments come later.
    assert values['use_sim_time'] is True and values['autostart'] is False


@pytest.mark.parametrize('executable', ['centroid_extractor', 'composed_pipeline'])
def test_the_depth_of_the_queue(started, probe, executable):
    launch, node = launch_file('pipeline', image_depth='7'), '/trk/centroid_extractor'
    started(launch, executable, node, [])
    # Declared with the subscription, which configure makes.
    probe.call(ChangeState, f'{node}/change_state', ChangeState.Request(
        transition=Transition(id=Transition.TRANSITION_CONFIGURE)))

    def depth():
        values = probe.call(GetParameters, f'{node}/get_parameters',
                            GetParameters.Request(names=[DEPTH])).values
        return [parameter_value_to_python(value) for value in values]
    probe.wait(depth, 'the subscription')
    assert depth() == [7]


@pytest.mark.parametrize('argument, expected', [('', True), ('false', False)])
def test_a_parent_sets_what_no_argument_says(started, argument, expected):
    names = ['use_sim_time', 'autostart', 'min_stars']
    assert started(
        launch_file('pipeline', use_sim_time=argument), 'star_tracker', '/trk/star_tracker',
        names, [('use_sim_time', True), ('min_stars', 7)]) == {
            'use_sim_time': expected, 'autostart': False, 'min_stars': 7}


@pytest.mark.parametrize('executable', ['star_tracker', 'composed_pipeline'])
def test_what_a_parent_sets_for_other_nodes_is_a_warning(started, tmp_path, executable):
    path = tmp_path / 'robot.yaml'
    path.write_text('/**:\n  ros__parameters: {robot: {radius: 0.2}, max_stars: 30}\n'
                    '/planner:\n  ros__parameters: {horizon_s: 1.0}\n')
    assert started(
        launch_file('pipeline'), executable, '/trk/star_tracker', ['max_stars'],
        [('robot_description', '<robot/>'), ('min_star', 7), path]) == {'max_stars': 30}
    warning, = (line for line in (tmp_path / f'{executable}.log').read_text().splitlines()
                if 'ignored' in line and 'star_tracker' in line)
    assert warning.endswith('not known here and ignored, as set for all nodes: robot_description, '
                            'min_star, robot.radius; did you mean min_stars for min_star?')


@pytest.mark.parametrize('name, executable, given, expected', [
    ('replay', 'bag_player', {'bag': '2024'}, {
        'path': '2024', 'wait_limit_s': 300.0, 'rate': 1.0, 'loop': False, 'start_offset_s': 0.0}),
    ('replay', 'bag_player', {'bag': 'b', 'rate': '2', 'loop': 'true', 'start_offset': '3.5'}, {
        'path': 'b', 'wait_for_camera_users': 4, 'rate': 2.0, 'loop': True,
        'start_offset_s': 3.5}),
    ('pipeline', 'pipeline_manager', {}, {'node_names': [*STAGES[::-1]]}),
    ('heads', 'attitude_fusion', {'mounts_file': ''}, {'mounts_file': ''}),
    ('heads', 'attitude_fusion', {'mounts_file': 'm.yaml'}, {'mounts_file': 'm.yaml'}),
    ('two_satellites', 'target_locator', {'observer_1': 'a', 'observer_2': 'b'},
     {'observer_1': 'a', 'observer_2': 'b'}),
    ('demo', 'sky_simulator', {'use_sim_time': 'true'}, {'use_sim_time': True}),
    ('camera', 'camera_source', {'use_sim_time': 'true'}, {'use_sim_time': True})])
def test_the_arguments_of_each_launch_file(started, mine, name, executable, given, expected):
    # Not configured: the files that the parameters name are not there.
    launch = launch_file(name, params_file=mine(f'/**/{executable}', autostart=False), **given)
    assert started(launch, executable, f'/trk/{executable}', list(expected)) == expected


@pytest.mark.parametrize('namespace, before', [
    ('', ''), ('/trk', '/trk'), ('fleet/trk', '/fleet/trk')])
@pytest.mark.parametrize('executable', ['star_tracker', 'composed_pipeline'])
def test_a_folder_of_files_in_each_namespace(started, tmp_path, executable, namespace, before):
    folder = tmp_path / 'mine'
    folder.mkdir()
    for stage in STAGES:
        text = (SOURCE / 'config' / f'{stage}.yaml').read_text()
        (folder / f'{stage}.yaml').write_text(text.replace('max_stars: 40', 'max_stars: 33'))
    launch = launch_file('pipeline', config=str(folder), namespace=namespace, log_level='debug')
    values = started(launch, executable, f'{before}/star_tracker', ['max_stars', 'autostart'])
    assert values == {'max_stars': 33, 'autostart': False}
    # The argument log_level.
    assert '[DEBUG]' in (tmp_path / f'{executable}.log').read_text()
