# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The configurations of viewers name what exists; the marks stand at the centroids."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import is_dataclass
import json
from pathlib import Path
import re
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints, Literal, Union

from foxglove import layouts
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, STAR_DTYPE, TRACK_DTYPE
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import centroids_to_image_marker
from startracker_ros.ros.messages.message_types import message_class
from visualization_msgs.msg import ImageMarker
import yaml

CONFIG = Path(__file__).parents[3] / 'config'
TYPES = {
    '/image_raw': 'sensor_msgs/msg/Image', '/image_annotated': 'sensor_msgs/msg/Image',
    '/camera_info': 'sensor_msgs/msg/CameraInfo',
    '/image_markers': 'visualization_msgs/msg/ImageMarker',
    '/centroids': 'sensor_msgs/msg/PointCloud2', '/tracks': 'sensor_msgs/msg/PointCloud2',
    '/truth/stars': 'sensor_msgs/msg/PointCloud2',
    '/attitude': 'geometry_msgs/msg/QuaternionStamped', '/attitude_imu': 'sensor_msgs/msg/Imu',
    '/tracker_state': 'diagnostic_msgs/msg/DiagnosticStatus',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'}
CLOUDS = {'/centroids': CENTROID_DTYPE, '/tracks': TRACK_DTYPE, '/truth/stars': STAR_DTYPE}


@pytest.fixture(scope='module')
def layout() -> dict[str, Any]:
    return json.loads((CONFIG / 'foxglove_layout.json').read_text())


def panels_in(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert node['direction'] in ('row', 'column') and 0 < node['splitPercentage'] < 100
        yield from panels_in(node['first'])
        yield from panels_in(node['second'])


def test_every_panel_is_placed_once_and_configured(layout: dict[str, Any]) -> None:
    placed = list(panels_in(layout['layout']))
    assert sorted(placed) == sorted(layout['configById'])
    assert {panel.split('!')[0] for panel in placed} == {
        'Image', '3D', 'Plot', 'StateTransitions', 'DiagnosticSummary', 'DiagnosticStatusPanel'}


def test_topics_of_the_layout_exist_with_the_types_that_the_panels_need(
        layout: dict[str, Any]) -> None:
    panels = layout['configById']
    image = panels['Image!stars']['imageMode']
    assert TYPES[image['imageTopic']] == 'sensor_msgs/msg/Image'
    assert TYPES[image['calibrationTopic']] == 'sensor_msgs/msg/CameraInfo'
    assert [TYPES[topic] for topic in image['annotations']] == [
        'visualization_msgs/msg/ImageMarker']
    for topic, settings in panels['3D!sky']['topics'].items():
        assert settings.get('colorField', 'x') in CLOUDS[topic].names
    for panel in ('DiagnosticSummary!all', 'DiagnosticStatusPanel!tracker'):
        assert TYPES[panels[panel]['topicToRender']] == 'diagnostic_msgs/msg/DiagnosticArray'


def test_paths_of_the_plots_lead_to_a_value(layout: dict[str, Any]) -> None:
    paths = [path for panel in layout['configById'].values() for path in panel.get('paths', ())]
    assert len(paths) == 13
    for path in paths:
        topic, *names = path['value'].split('.')
        value = message_class(TYPES[topic])()
        assert path['timestampMethod'] == 'receiveTime' or hasattr(value, 'header')
        for name in names:
            name, index = re.fullmatch(r'(\w+)(?:\[(\d+)\])?', name).groups()
            value = getattr(value, name)
            value = value if index is None else value[int(index)]
        assert isinstance(value, (int, float, str))


# What the application and its SDK call differently.
SDK_NAMES = {'3D': 'ThreeDee', 'DiagnosticSummary': 'DiagnosticsSummary',
             'DiagnosticStatusPanel': 'DiagnosticsDetail'}


def settings(value: Any, kind: Any) -> Any:
    """Return JSON as the settings of foxglove-sdk; ValueError where they do not allow it."""
    options = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        for option in options:
            with suppress(ValueError):
                return settings(value, option)
    elif get_origin(kind) is Literal and value in options:
        return value
    elif get_origin(kind) is list and isinstance(value, list):
        return [settings(each, options[0]) for each in value]
    elif get_origin(kind) is tuple and isinstance(value, list) and len(value) == len(options):
        return tuple(map(settings, value, options))
    elif get_origin(kind) is dict and isinstance(value, dict):
        return {key: settings(each, options[1]) for key, each in value.items()}
    elif is_dataclass(kind) and isinstance(value, dict):
        kinds = get_type_hints(kind, vars(layouts))
        named = {re.sub('([A-Z])', r'_\1', key).lower(): each for key, each in value.items()}
        if named.keys() <= kinds.keys():
            return kind(**{name: settings(each, kinds[name]) for name, each in named.items()})
    elif kind is float and type(value) in (int, float) or type(value) is kind:
        return value
    raise ValueError(f'{value!r} is not {kind}')


def holds(whole: Any, part: Any) -> bool:
    """Return whether JSON holds a part of it, in addition to other keys."""
    if isinstance(part, dict):
        return all(key in whole and holds(whole[key], value) for key, value in part.items())
    return whole == part


def test_foxglove_knows_every_setting_and_value(layout: dict[str, Any]) -> None:
    """By the types that Foxglove publishes for layouts, which reject other names and values."""
    for name, config in layout['configById'].items():
        kind = name.split('!')[0]
        panel = getattr(layouts, f'{SDK_NAMES.get(kind, kind)}Panel')
        own = {key: value for key, value in config.items() if key != 'foxglovePanelTitle'}
        built = settings(own, type(panel().config))
        assert holds(json.loads(built.to_json()), own), name
    with pytest.raises(ValueError):
        settings({**own, 'colour': 'red'}, type(panel().config))
    with pytest.raises(ValueError):
        settings({'paths': [{'timestampMethod': 'never'}]}, layouts.PlotConfig)


@pytest.fixture(scope='module')
def rviz() -> dict[str, Any]:
    return yaml.safe_load((CONFIG / 'star_tracker.rviz').read_text())['Visualization Manager']


def test_the_rviz_configuration_names_topics_that_exist(rviz: dict[str, Any]) -> None:
    wanted = {'rviz_default_plugins/PointCloud2': 'sensor_msgs/msg/PointCloud2',
              'rviz_default_plugins/Image': 'sensor_msgs/msg/Image'}
    shown = [display for display in rviz['Displays'] if 'Topic' in display]
    assert len(shown) == 4
    for display in shown:
        topic = display['Topic']['Value']
        assert TYPES[topic] == wanted[display['Class']]
        assert display.get('Channel Name', 'x') in CLOUDS.get(topic, TRACK_DTYPE).names
    assert rviz['Global Options']['Fixed Frame'] == 'star_tracker_optical_frame'


def seen_by_rviz(view: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """
    Return points (N, 3) in the picture of an orbit view of RViz: (N, 2) from -1 to 1 upwards.

    RViz looks from a distance at the focal point, with z up and 45 deg from top to bottom.
    """
    yaw, pitch = view['Yaw'], view['Pitch']
    back = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.cross(-back, [0, 0, 1])
    right /= np.linalg.norm(right)
    from_eye = points - [view['Focal Point'][axis] for axis in 'XYZ'] - view['Distance'] * back
    depth = -from_eye @ back
    assert (depth > view['Near Clip Distance']).all()
    return from_eye @ np.stack([right, np.cross(right, -back)], -1) / (
        depth * np.tan(np.radians(22.5)))[:, None]


def test_rviz_shows_the_field_as_the_image_is(rviz: dict[str, Any]) -> None:
    """With the messages of a recording, read without a module of this package."""
    clouds = {display['Topic']['Value']: display for display in rviz['Displays']
              if display['Class'].endswith('PointCloud2') and display['Enabled']}
    assert sorted(clouds) == ['/centroids', '/tracks']
    with open(next((CONFIG.parent / 'bags' / 'slew').glob('*.mcap')), 'rb') as file:
        newest = {channel.topic: (schema.name, message) for schema, channel, _, message in
                  make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
                  if channel.topic in TYPES}
    assert {topic: kind for topic, (kind, _) in newest.items()} == {
        topic: TYPES[topic] for topic in newest}
    for topic, display in clouds.items():
        cloud = newest[topic][1]
        assert cloud.header.frame_id == rviz['Global Options']['Fixed Frame']
        columns = {field.name: np.ndarray(
            cloud.width, '<f4', bytes(cloud.data), field.offset, cloud.point_step)
            for field in cloud.fields if field.datatype == 7}
        assert cloud.width > 10
        places = seen_by_rviz(rviz['Views']['Current'],
                              np.stack([columns[axis] for axis in 'xyz'], -1))
        assert (np.abs(places) < [1400 / 900, 1]).all()
        # The field fills a third of the window or more, upright and not mirrored.
        assert np.ptp(places, axis=0).min() > 2 / 3
        for place, pixel in zip(places.T, (columns['u'], -columns['v'])):
            assert np.corrcoef(place, pixel)[0, 1] > 0.99
        if display['Color Transformer'] == 'Intensity':
            magnitude = columns[display['Channel Name']]
            assert display['Min Intensity'] <= magnitude.min()
            assert magnitude.max() <= display['Max Intensity']


def test_marks_stand_beside_the_centroids() -> None:
    uv = np.array([(100.0, 200.0), (0.25, 1023.5)])
    header = make_header(5, 'star_tracker_optical_frame')
    marker = deserialize_message(centroids_to_image_marker(uv, header), ImageMarker)
    assert marker.type == ImageMarker.LINE_LIST and marker.header.stamp.nanosec == 5
    points = np.array([(point.x, point.y) for point in marker.points]).reshape(2, 2, 2, 2)
    # Of each star a tick to the right and one below, none of them on it.
    np.testing.assert_allclose(points[:, 0, :, 1], np.repeat(uv[:, 1:], 2, axis=1))
    np.testing.assert_allclose(points[:, 1, :, 0], np.repeat(uv[:, :1], 2, axis=1))
    assert np.all(points[:, 0, :, 0] - uv[:, :1] >= 6)
    assert np.all(points[:, 1, :, 1] - uv[:, 1:] >= 6)
    none = deserialize_message(centroids_to_image_marker(np.empty((0, 2)), header), ImageMarker)
    assert none.points == [] and none.outline_color.g == 0.75
