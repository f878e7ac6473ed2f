# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The SROS 2 policies allow each node what it opens, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

from lxml import etree
import pytest
import rclpy
from rclpy.validate_namespace import validate_namespace
from startracker_ros.core.camera.model import Camera
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.executables import NODES, STAGES
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.node import node_class_of, PipelineNode
from startracker_ros.ros.processes import parameter_arguments

CONFIG = Path(__file__).parents[2] / 'config'
FLIGHT, GROUND = 'security_policy.xml', 'security_policy_ground.xml'
# No nodes of this package, but part of the system.
OTHERS = {'camera', 'gyro', 'gnc', 'operator'}
SELF_MADE = {'sky_simulator', 'image_publisher', 'camera_source', 'bag_player'}
# Their topics are not known beforehand.
ANY = {'bag_recorder', 'bag_player'}
# Every way of starting a node that opens other topics.
VARIANTS = {
    'sky_simulator': ({}, {'motion': 'topic'}),
    'camera_calibrator': ({}, {'calibration_mode': 'apply'}),
    'star_identifier': ({}, {'method': 'extended_grid'}),
    'attitude_estimator': ({'source': 'tracks', 'sub_frames': 2}, {'source': 'stars'},
                           {'publish_frames': True, 'body_frame_id': 'body'})}


def profiles(file: str) -> dict[str, dict[tuple[str, str], set[str]]]:
    """Return {node: {(kind, verb): full names}} of a policy."""
    found = {}
    root = ElementTree.parse(CONFIG / file).getroot()
    assert root.tag == 'policy' and root.get('version') == '0.2.0'
    for enclave in root.iterfind('enclaves/enclave'):
        profile, = enclave.iterfind('profiles/profile')
        node = profile.get('node')
        assert profile.get('ns') == '/' and enclave.get('path') == f'/startracker_ros/{node}'
        rules = {}
        for group in profile:
            (verb, permission), = group.attrib.items()
            assert permission == 'ALLOW'
            assert (group.tag, verb) in {('topics', 'publish'), ('topics', 'subscribe'),
                                         ('services', 'reply'), ('services', 'request')}
            names = [name.text.replace('~', f'/{node}') for name in group]
            assert len(names) == len(set(names))
            assert all(name.tag == group.tag.removesuffix('s') for name in group)
            rules[group.tag, verb] = {f'/{name.lstrip("/")}' for name in names}
        assert node not in found
        found[node] = rules
    return found


# By tag: attributes that an element must have, those that it may have, and what is in it.
RULES = {'ALLOW', 'DENY'}
SCHEMA = {
    'policy': ({'version'}, set(), {'enclaves'}), 'enclaves': (set(), set(), {'enclave'}),
    'enclave': ({'path'}, set(), {'profiles'}), 'profiles': (set(), {'type'}, {'profile'}),
    'profile': ({'ns', 'node'}, set(), {'topics', 'services', 'actions'}),
    'topics': (set(), {'publish', 'subscribe'}, {'topic'}),
    'services': (set(), {'reply', 'request'}, {'service'}),
    'actions': (set(), {'call', 'execute'}, {'action'}),
    'topic': (set(), set(), set()), 'service': (set(), set(), set()),
    'action': (set(), set(), set())}


def assert_of_schema(element: etree._Element) -> None:
    """Check an element, and all in it, by policy.xsd of sros2."""
    required, optional, inner = SCHEMA[element.tag]
    assert required <= set(element.attrib) <= required | optional, element.tag
    assert all(element.get(name) in RULES for name in optional & set(element.attrib) - {'type'})
    children = list(element.iterchildren(etree.Element))
    assert {child.tag for child in children} <= inner and bool(children) == bool(inner)
    assert bool((element.text or '').strip()) == (not inner), element.tag
    for child in children:
        assert_of_schema(child)


@pytest.mark.parametrize('file', [FLIGHT, GROUND])
def test_sros2_takes_the_policies(file):
    """Check what sros2 0.13 does with a policy; `make test-ros` runs it where it is installed."""
    policy = etree.parse(str(CONFIG / file)).getroot()
    assert_of_schema(policy)
    # generate_artifacts takes every child, also a comment, for an enclave.
    enclaves = [child.get('path') for child in policy.find('enclaves')]
    assert len(enclaves) == len(set(enclaves))
    assert all(path and validate_namespace(path) for path in enclaves), enclaves


def opened(node: PipelineNode) -> dict[tuple[str, str], set[str]]:
    """Return what a node has opened, by full name; rcl opens the log and the transitions."""
    return {
        ('topics', 'publish'): {
            '/rosout', f'/{node.get_name()}/transition_event',
            *(one.topic_name for one in node.publishers)},
        ('topics', 'subscribe'): {one.topic_name for one in node.subscriptions},
        ('services', 'reply'): {service.service_name for service in node.services},
        ('services', 'request'): {client.service_name for client in node.clients}}


@pytest.fixture
def image_folder(tmp_path):
    """Return a folder that image_publisher takes."""
    import cv2
    import numpy as np
    cv2.imwrite(str(tmp_path / 'stars.png'), np.zeros((64, 64), np.uint8))
    return tmp_path


def start(name: str, parameters: dict[str, object]) -> dict[tuple[str, str], set[str]]:
    """Return what a node opens once it knows its camera."""
    rclpy.init(args=parameter_arguments(parameters) if parameters else None)
    try:
        node = node_class_of(name)()
        node.begin()
        if isinstance(node, CameraNode):
            if not node.has_publisher(node.frame_topic):
                node.subscribe_camera_info()
            node._on_camera_info(camera_to_message(
                Camera.from_fov(512, 512, 20.0), make_header(1_767_225_600 * 10 ** 9, 'lens')))
        found = opened(node)
        node.destroy_node()
        return found
    finally:
        rclpy.try_shutdown()


def test_every_node_has_one_policy_and_flight_has_none_that_makes_data_up():
    flight, ground = profiles(FLIGHT), profiles(GROUND)
    assert set(flight) == set(NODES) - SELF_MADE | OTHERS
    assert set(ground) == SELF_MADE


@pytest.mark.parametrize('name', sorted(set(NODES) - ANY))
def test_a_node_is_allowed_what_it_opens_and_no_more(name, image_folder):
    expected = {**profiles(FLIGHT), **profiles(GROUND)}[name]
    variants = VARIANTS.get(name, ({},))
    if name == 'image_publisher':
        variants = ({'path': str(image_folder)},)
    found: dict[tuple[str, str], set[str]] = {}
    for parameters in variants:
        for rule, names in start(name, parameters).items():
            found.setdefault(rule, set()).update(names)
    assert {rule: names for rule, names in found.items() if names} == expected


def test_the_recorder_says_only_how_it_is(tmp_path):
    allowed = profiles(FLIGHT)['bag_recorder']
    found = start('bag_recorder', {'folder': str(tmp_path / 'bag')})
    assert found['topics', 'publish'] == allowed['topics', 'publish']
    assert found['services', 'reply'] == allowed['services', 'reply']
    assert not found['services', 'request'] and ('services', 'request') not in allowed
    assert '/*' in allowed['topics', 'subscribe']


def test_nobody_in_flight_is_allowed_everything_or_the_clock():
    for node, rules in profiles(FLIGHT).items():
        said = rules['topics', 'publish'] | rules['services', 'reply']
        said |= rules.get(('services', 'request'), set())
        assert not any('*' in name for name in said), node
        heard = rules.get(('topics', 'subscribe'), set())
        assert '/clock' not in said | heard, node
        assert '/*' not in heard or node == 'bag_recorder'


def test_each_topic_of_the_pipeline_has_one_source():
    flight = profiles(FLIGHT)
    # With several heads it runs outside their namespaces, instead of an estimator there.
    fusion = flight.pop('attitude_fusion')
    assert ('topics', 'publish') in fusion
    common = {'/diagnostics', '/parameter_events', '/rosout'}
    sources: dict[str, list[str]] = {}
    for node, rules in flight.items():
        for topic in rules['topics', 'publish'] - common:
            sources.setdefault(topic, []).append(node)
    assert all(len(nodes) == 1 for nodes in sources.values()), sources
    heard = set().union(*(flight[node].get(('topics', 'subscribe'), set()) for node in flight))
    # The fusion publishes hints in the namespaces of the heads.
    elsewhere = {topic for topic in heard - set(sources) - common - {'/hint'} if '*' not in topic}
    assert all(topic.startswith(('/tracker_1/', '/tracker_2/')) for topic in elsewhere)


def test_only_the_operator_changes_anything_and_the_manager_states():
    flight = profiles(FLIGHT)
    asking = {node for node, rules in flight.items() if ('services', 'request') in rules}
    assert asking == {'operator', 'pipeline_manager', 'camera_calibrator', 'exposure_controller'}
    assert flight['camera_calibrator']['services', 'request'] == {'/set_camera_info'}
    assert flight['exposure_controller']['services', 'request'] == {
        f'/usb_cam/{service}' for service in ('get_parameters', 'set_parameters')}
    assert flight['pipeline_manager']['services', 'request'] == {
        f'/{stage}/{service}' for stage in STAGES for service in ('change_state', 'get_state')}
    offered = set().union(*(flight[node]['services', 'reply']
                            for node in set(flight) - OTHERS))
    assert flight['operator']['services', 'request'] == offered
