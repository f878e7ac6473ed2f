# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""pipeline_manager with real processes: brought up, killed, started again, deactivated."""

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.processes import node_command, parameter_arguments

NODES = ('attitude_estimator', 'target_locator')
NAMESPACE = 'trk'


def state(probe, node):
    return probe.call(GetState, f'/{NAMESPACE}/{node}/get_state',
                      GetState.Request()).current_state.label


def test_nodes_are_brought_up_and_again_after_they_were_killed(nodes, probe):
    def start(node):
        nodes.start(node, {'autostart': False}, namespace=NAMESPACE)

    def restarts():
        return probe.diagnostic_value('pipeline_manager: nodes', f'restarts of {NODES[0]}')
    nodes.start('pipeline_manager', {'node_names': NODES, 'heartbeat_period_s': 0.2,
                                     'response_timeout_s': 1.5}, namespace=NAMESPACE)
    start(NODES[1])
    probe.wait_diagnostic(f'{NODES[0]} does not respond, {NODES[1]} is unconfigured')
    start(NODES[0])
    probe.wait_diagnostic('all 2 nodes are active')
    log = (nodes.log_folder / f'{NAMESPACE}.pipeline_manager.log').read_text()
    wanted = [f'{transition} {node}' for transition in ('configure', 'activate')
              for node in NODES]
    # On a busy machine a request is repeated.
    assert list(dict.fromkeys(line.partition(']: ')[2] for line in log.splitlines()
                              if line.endswith(NODES))) == wanted
    assert {state(probe, node) for node in NODES} == {'active'}
    # As launch does with respawn: the first time it is missed, the second time hardly.
    for missed in (True, False):
        before = restarts()
        nodes.kill(f'{NAMESPACE}.{NODES[0]}')
        if missed:
            probe.forget()
            probe.wait_diagnostic(f'{NODES[0]} does not respond')
        start(NODES[0])
        probe.wait(lambda before=before: restarts() not in (None, before), 'a restart')
        probe.wait(lambda: state(probe, NODES[0]) == 'active', 'active again')
    assert restarts() == '2'
    # Somebody deactivates the other one: that is left alone, and reported.
    request = ChangeState.Request(transition=Transition(
        id=Transition.TRANSITION_DEACTIVATE))
    assert probe.call(ChangeState, f'/{NAMESPACE}/{NODES[1]}/change_state', request).success
    probe.forget()
    probe.wait_diagnostic(f'{NODES[1]} is inactive')
    assert state(probe, NODES[1]) == 'inactive'
    # The heartbeat continues during other requests.
    assert probe.call(GetParameters, f'/{NAMESPACE}/{NODES[0]}/get_parameters',
                      GetParameters.Request(names=['autostart'])).values


def test_a_second_manager_is_named(nodes, probe):
    nodes.start('attitude_estimator', {'autostart': False})
    for name in ('first', 'second'):
        assert not probe.find_diagnostic('another lifecycle manager')
        nodes.run(name, node_command('pipeline_manager', parameter_arguments(
            {'node_names': ['attitude_estimator'], 'response_timeout_s': 1.0})))
        probe.wait_diagnostic('all 1 nodes are active')
    probe.wait_diagnostic('another lifecycle manager has attitude_estimator, too')


def test_a_healthy_start_logs_no_warning(nodes, probe, tmp_path):
    for node in STAGES:
        nodes.start(node, {'autostart': False})
    nodes.start('pipeline_manager')
    # What comes before that is dropped.
    probe.wait_diagnostic(f'all {len(STAGES)} nodes are active')
    nodes.start('sky_simulator', {'wait_for_camera_users': len(STAGES), 'frames_ahead': 1,
                                  'width': 512, 'height': 512, 'fov_deg': 12.0})
    probe.wait_diagnostic('publishing attitude')
    probe.wait_diagnostic('TRACKING')
    lines = [line for log in tmp_path.glob('*.log') for line in log.read_text().splitlines()]
    assert any('ACQUIRING' in line for line in lines)
    # Of a machine that is busy with something else.
    assert [line for line in lines if '[WARN]' in line and 'busy or stopped' not in line] == []
