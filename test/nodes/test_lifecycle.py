# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every node at run time: parameters changed, signals, one line in the log for a transition."""

from pathlib import Path
import re
import signal

from diagnostic_msgs.msg import DiagnosticStatus
from limits import HANGS_S
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import Image
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros import qos, tables
from startracker_ros.ros.executables import NODES
from std_srvs.srv import Trigger
import yaml

ROOT = Path(__file__).parents[2]
ANALYZERS = ROOT / 'config' / 'diagnostic_analyzers.yaml'
GOLDEN_BAG = ROOT / 'bags' / 'slew'
PIPELINE = ('centroid_extractor', 'star_identifier', 'star_tracker', 'attitude_estimator')
# Slow enough that a frame is done before the next one on a busy machine, too.
SKY = {'width': 256, 'height': 256, 'fov_deg': 20.0, 'frame_rate_hz': 2.0,
       'motion': 'constant_rate', 'faint_limit': 6.5}
RESETTABLE = {'star_identifier', 'star_tracker', 'attitude_estimator', 'attitude_fusion',
              'target_locator', 'camera_calibrator'}
# Of parameters whose values are not free.
OTHERS = {'destination': 'udp://127.0.0.1:10036', 'mount_quaternion': (0.6, 0.0, 0.0, 0.8)}
# Of models that are not the default.
STAR_BY_STAR = {'solver', 'association', 'sna_confirmation', 'roll_by_gyro'}


def start_all(nodes, probe, folder, sky_data):
    """Start every node there is, and wait until those that need a camera know one."""
    own = {
        'sky_simulator': SKY,
        'image_publisher': {'path': str(sky_data / 'night-sky-11deg'), 'wait_for_subscribers': 1},
        'bag_player': {'path': str(GOLDEN_BAG), 'topics': ['/truth/attitude'],
                       'start_paused': True},
        'bag_recorder': {'folder': str(folder / 'bag'), 'topics': ['/image_raw', '/attitude']},
        'camera_calibrator': {'calibration_mode': 'propose'},
        # Topics that are advertised on request only.
        'attitude_estimator': {'publish_frames': True, 'body_frame_id': 'body', 'sub_frames': 2}}
    # Several sources of images in one namespace would be several cameras for one pipeline.
    place = {'image_publisher': 'files', 'camera_source': 'camera'}
    for node in NODES:
        nodes.start(node, own.get(node), namespace=place.get(node, ''))
    for node in NODES:
        name = '.'.join([place[node], node]) if node in place else node
        lines = ('ready', 'camera ') if node in (*PIPELINE, 'camera_calibrator') else ('ready',)
        for words in lines:
            probe.wait(lambda n=name, w=words: w in log(folder, n), f'{words!r} of {node}')
    return {node: f'/{place[node]}/{node}' if node in place else f'/{node}' for node in NODES}


def log(folder, name):
    return (folder / f'{name}.log').read_text()


def ask_once(probe, service_type, name, request):
    """
    Return the answer to a request that must not be repeated.

    One without parameters, which changes nothing, is repeated before it until the service has
    discovered its client and is heard: see Probe.ask.
    """
    client = probe.create_client(service_type, name)
    probe.wait(client.service_is_ready, name)
    asked = []

    def heard():
        if len(asked) == 0 or probe.get_clock().now().nanoseconds > asked[-1][0] + 3 * 10 ** 9:
            asked.append((probe.get_clock().now().nanoseconds,
                          client.call_async(service_type.Request())))
        return any(future.done() for _, future in asked)
    probe.wait(heard, f'an answer of {name}')
    future = client.call_async(request)
    probe.wait(future.done, f'an answer of {name}')
    return future.result()


def changed(name, value):
    return Parameter(name, value=list(value) if isinstance(value, tuple) else value
                     ).to_parameter_msg()


def another(row):
    """Return a value in the range of a parameter that is not its default."""
    if row.name in OTHERS:
        return OTHERS[row.name]
    if row.choices:
        return next(choice for choice in row.choices if choice != row.default)
    if isinstance(row.default, bool):
        return not row.default
    if isinstance(row.default, str):
        return 'another'
    if isinstance(row.default, int):
        return row.default + (1 if row.high is None or row.default < row.high else -1)

    if isinstance(row.default, tuple) and isinstance(row.default[0], str):
        return ('another',)

    def nearby(value):
        bound = row.high if row.high is not None and value < row.high else row.low
        return value + 1.0 if bound is None else 0.99 * value + 0.01 * bound
    return tuple(map(nearby, row.default)) if isinstance(row.default, tuple) else nearby(
        row.default)


def other(row, before):
    """Return a value in the range of a parameter that is not the one of before."""
    return next(value for value in (another(row), row.default) if value != before)


def beyond(row):
    """Return a value out of the range of a parameter, None where all of the type will do."""
    if row.choices:
        return 'nonsense'
    if row.low is None and row.high is None:
        return None
    value = row.low - 1 if row.low is not None else row.high + 1
    if isinstance(row.default, tuple):
        return (float(value), *row.default[1:])
    return type(row.default)(value)


def check_parameters(probe, places, folder):
    """Check that every parameter takes effect, or is rejected with a reason."""
    for node, place in places.items():
        rows = tables.node_rows(node)
        settable = [row for row in rows if not row.read_only]
        wrong = [row for row in settable if beyond(row) is not None]
        names = GetParameters.Request(names=[row.name for row in rows])
        kept = probe.call(GetParameters, f'{place}/get_parameters', names).values
        values = {row.name: parameter_value_to_python(value) for row, value in zip(rows, kept)}
        wishes = [changed(row.name, value) for row in settable
                  for value in (other(row, values[row.name]), values[row.name])]
        wishes += [changed(row.name, beyond(row)) for row in wrong]
        wishes += [changed(row.name, other(row, values[row.name]))
                   for row in rows if row.read_only]
        results = ask_once(probe, SetParameters, f'{place}/set_parameters',
                           SetParameters.Request(parameters=wishes)).results
        lines = log(folder, place.strip('/').replace('/', '.'))
        for k, row in enumerate(settable):
            if row.name == 'camera_file':
                assert not results[2 * k].successful
                assert 'camera file another: No such file' in results[2 * k].reason
                continue
            if node == 'star_tracker' and row.name in STAR_BY_STAR:
                assert not results[2 * k].successful
                assert 'has no effect with model' in results[2 * k].reason
                continue
            assert results[2 * k].successful, (node, row.name, results[2 * k].reason)
            assert results[2 * k + 1].successful, (node, row.name, results[2 * k + 1].reason)
            # Once with the other value, once with that of before.
            assert len(re.findall(rf'parameters changed: {row.name} = ', lines)) == 2
        refused = results[2 * len(settable):]
        for row, result in zip(wrong, refused):
            assert not result.successful, (node, row.name)
            assert row.name in result.reason and row.range_text in result.reason
            assert row.unit in result.reason
        for row, result in zip([row for row in rows if row.read_only], refused[len(wrong):]):
            assert not result.successful, (node, row.name)
            assert result.reason == (
                f'{row.name} is read at the start only: end the node and start it again with '
                f'-p {row.name}:=...')
        assert probe.call(GetParameters, f'{place}/get_parameters', names).values == kept


def test_several_changes_are_made_together_or_not_at_all(nodes, probe):
    nodes.start('attitude_estimator')

    def values():
        return [parameter_value_to_python(value) for value in probe.call(
            GetParameters, '/attitude_estimator/get_parameters',
            GetParameters.Request(names=['min_stars', 'max_residual_px'])).values]

    def change(*wishes):
        return ask_once(probe, SetParametersAtomically,
                        '/attitude_estimator/set_parameters_atomically',
                        SetParametersAtomically.Request(parameters=[
                            changed(name, value) for name, value in wishes])).result
    before = values()
    refused = change(('min_stars', 7), ('max_residual_px', -1.0))
    assert not refused.successful and 'max_residual_px' in refused.reason
    assert values() == before
    assert change(('min_stars', 7), ('max_residual_px', 1.5)).successful
    assert values() == [7, 1.5]
    integer = change(('max_residual_px', 2))
    assert not integer.successful and 'write 2.0' in integer.reason


def end_all(nodes, folder):
    """End every node by SIGINT: with status 0, and a bag that needs no repair."""
    for process in nodes.processes.values():
        process.send_signal(signal.SIGINT)
    assert {name: process.wait(HANGS_S) for name, process in nodes.processes.items()} == (
        dict.fromkeys(nodes.processes, 0))
    assert len(list(read_messages(folder / 'bag', topics=('/image_raw',)))) > 5


def documented(column):
    """Return the topics of each node in a column of the table in docs/nodes.md."""
    rows = [line.split('|')[1:] for line in (ROOT / 'docs' / 'nodes.md').read_text().splitlines()
            if line.startswith('| `')]
    return {cells[0].strip(' `'): set(re.findall('`([a-z0-9_/]+)`', cells[column]))
            for cells in rows if cells[0].strip(' `') in NODES}


def check_topics_and_reset(probe, places, folder):
    """Check that every node has the topics of its document, and forgets its state on request."""
    publishes, subscribes = documented(2), documented(1)
    assert publishes.keys() == subscribes.keys() == set(NODES)
    for node, place in places.items():
        space = place.removesuffix(node)
        where = space.rstrip('/') or '/'

        def names(topics, space=space):
            own = {name for name, _ in topics if not name.endswith('/transition_event')} - {
                '/diagnostics', '/rosout', '/parameter_events', '/clock'}
            return {re.sub('^tracker_[12]/', '', name.removeprefix(space)) for name in own}

        def publishes_all(node=node, where=where, names=names):
            return names(probe.get_publisher_names_and_types_by_node(
                node, where)) == publishes[node]
        # Nodes and their endpoints are discovered one after the other. The player publishes what
        # its bag has.
        probe.wait(lambda node=node, where=where: (node, where)
                   in probe.get_node_names_and_namespaces(), f'the node {place}')
        if node != 'bag_player':
            probe.wait(publishes_all, f'the topics of {node}: {publishes[node]}')
        if node != 'bag_recorder':
            assert names(probe.get_subscriber_names_and_types_by_node(
                node, where)) <= subscribes[node], node
        reset = f'{place}/reset'
        if node in RESETTABLE:
            answer = probe.call(Trigger, reset, Trigger.Request())
            assert answer.success and answer.message == 'state forgotten'
            probe.wait(lambda node=node, reset=reset: len(re.findall(
                'reset: state forgotten', log(folder, node))) == probe.requests[reset],
                'a line for each reset')
        services = {name for name, _ in probe.get_service_names_and_types_by_node(node, where)}
        assert (reset in services) == (node in RESETTABLE), node


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


def check_diagnostics(probe, places):
    """Check that each status is in one group of the aggregator, and each expected one is there."""
    groups = analyzers(yaml.safe_load(ANALYZERS.read_text())['analyzers']['ros__parameters'])

    def names():
        return {status.name for status in probe.statuses()}
    topics = {'centroid_extractor': 'image_raw', 'star_identifier': 'centroids',
              'star_tracker': 'centroids', 'attitude_estimator': 'tracks'}
    wanted = {f'{node}: {topic} topic status' for node, topic in topics.items()}
    assert topics.keys() == set(PIPELINE)

    def all_are_there():
        return wanted <= names() and {name.split(':')[0] for name in names()} == set(NODES)
    probe.wait(all_are_there, 'a status of every node')
    assert all(sum(is_match(group, name) for group in groups) == 1 for name in names()), names()
    assert {name for group in groups for name in group.get('expected', [])} <= names()
    for status in probe.statuses():
        namespace = places[status.name.split(':')[0]].strip('/').rpartition('/')[0]
        assert status.hardware_id == (namespace or 'star_tracker')
    assert len(names()) == len(NODES) + len(PIPELINE)


def test_every_node_has_its_topics_diagnostics_and_parameters_and_ends(
        rig, nodes, probe, tmp_path, sky_data):
    places = start_all(nodes, probe, tmp_path, sky_data)
    check_diagnostics(probe, places)
    check_topics_and_reset(probe, places, tmp_path)
    check_parameters(probe, places, tmp_path)
    assert nodes.ended() == []
    rig.remove_probe()
    end_all(nodes, tmp_path)


def transitions(folder, node):
    """Return the texts that a node has logged."""
    return re.findall(r'\]: (.*)', log(folder, node))


def test_each_transition_is_one_line_in_the_log(nodes, probe, tmp_path):
    states = probe.received['tracker_state']
    frames = probe.received['image_raw']
    probe.collect(Image, 'image_raw', qos.IMAGE)
    probe.collect(DiagnosticStatus, 'tracker_state', qos.STATE)
    for node in PIPELINE:
        nodes.start(node)
    nodes.start('sky_simulator', {
        **SKY, 'frame_rate_hz': 10.0, 'frames_ahead': 1, 'wait_for_camera_users': len(PIPELINE)})

    def reached(state, after=0):
        probe.wait(lambda: any(s.message == state for s in states[after:]), state)
        return len(states)

    def fly(count):
        end = len(frames) + count
        probe.wait(lambda: len(frames) >= end, f'{count} frames')

    def simulate(name, value):
        assert ask_once(probe, SetParameters, '/sky_simulator/set_parameters',
                        SetParameters.Request(parameters=[changed(name, value)])
                        ).results[0].successful
    reached('TRACKING')
    fly(10)
    seen = len(states)
    simulate('zero_flux_e_s', 1.0)
    seen = reached('LOST', seen)
    fly(10)
    simulate('zero_flux_e_s', 2e6)
    seen = reached('TRACKING', seen)
    fly(6)
    simulate('fov_deg', 21.0)

    def kinds():
        return [line.partition(':')[0] for line in transitions(tmp_path, 'star_tracker')
                if line.startswith(('LOST', 'ACQUIRING', 'TRACKING'))]
    probe.wait(lambda: len(kinds()) >= 6, 'TRACKING with another camera')
    probe.wait(lambda: transitions(tmp_path, 'attitude_estimator').count(
        'publishing attitude') >= 3, 'an attitude with another camera')
    fly(6)
    lines = transitions(tmp_path, 'star_tracker')
    assert kinds()[:6] == ['LOST', 'ACQUIRING', 'TRACKING', 'LOST', 'ACQUIRING', 'TRACKING'], lines
    assert all(': ' in line and line.partition(': ')[2] for line in lines
               if line.startswith(('LOST', 'ACQUIRING', 'TRACKING')))
    for node in PIPELINE:
        lines = transitions(tmp_path, node)
        assert len([line for line in lines if line.startswith('camera 256 x 256 px')]) == 2, lines
        # Some fifty frames and a handful of transitions.
        assert len(lines) <= 24, lines
        repeats = [a for a, b in zip(lines, lines[1:]) if a == b]
        assert repeats == []
    estimator = transitions(tmp_path, 'attitude_estimator')
    assert estimator.count('publishing attitude') == 3, estimator
    assert [line for line in estimator if line.startswith('no attitude: ')], estimator
    assert 'idle while the star tracker tracks' in transitions(tmp_path, 'star_identifier')
