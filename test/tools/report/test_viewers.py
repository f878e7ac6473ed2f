"""The configurations of viewers name what exists; the marks stand at the centroids."""

from collections.abc import Iterator
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest
from run_bag import write_run
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, STAR_DTYPE, TRACK_DTYPE
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image_marker import centroids_to_image_marker
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.tools.report.viewer_picture import draw_viewer
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


def test_the_rviz_configuration_names_topics_that_exist() -> None:
    manager = yaml.safe_load((CONFIG / 'star_tracker.rviz').read_text())['Visualization Manager']
    wanted = {'rviz_default_plugins/PointCloud2': 'sensor_msgs/msg/PointCloud2',
              'rviz_default_plugins/Image': 'sensor_msgs/msg/Image'}
    shown = [display for display in manager['Displays'] if 'Topic' in display]
    assert len(shown) == 4
    for display in shown:
        topic = display['Topic']['Value']
        assert TYPES[topic] == wanted[display['Class']]
        assert display.get('Channel Name', 'x') in CLOUDS.get(topic, TRACK_DTYPE).names
    assert manager['Global Options']['Fixed Frame'] == 'star_tracker_optical_frame'


def test_marks_stand_beside_the_centroids() -> None:
    uv = np.array([(100.0, 200.0), (0.25, 1023.5)])
    marker = centroids_to_image_marker(uv, make_header(5, 'star_tracker_optical_frame'))
    assert marker.type == ImageMarker.LINE_LIST and marker.header.stamp.nanosec == 5
    points = np.array([(point.x, point.y) for point in marker.points]).reshape(2, 2, 2, 2)
    # Of each star a tick to the right and one below, none of them on it.
    np.testing.assert_allclose(points[:, 0, :, 1], np.repeat(uv[:, 1:], 2, axis=1))
    np.testing.assert_allclose(points[:, 1, :, 0], np.repeat(uv[:, :1], 2, axis=1))
    assert np.all(points[:, 0, :, 0] - uv[:, :1] >= 6)
    assert np.all(points[:, 1, :, 1] - uv[:, 1:] >= 6)
    assert centroids_to_image_marker(np.empty((0, 2)), marker.header).points == []


@pytest.mark.slow
def test_the_picture_is_drawn_from_a_bag(run: Path, tmp_path: Path) -> None:
    draw_viewer(run, tmp_path / 'viewer.png')
    assert (tmp_path / 'viewer.png').read_bytes().startswith(b'\x89PNG')
    bare = write_run(tmp_path / 'bare', leave_out=('image_raw',))
    with pytest.raises(ValueError, match='no frame with image'):
        draw_viewer(bare, tmp_path / 'none.png')
