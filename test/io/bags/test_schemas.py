# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Definitions and hashes, against those that rosbags brings along and computes."""

from pathlib import Path
import re
import sys

import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore
from startracker_ros.io.bags.schemas import message_schema

LINE = '=' * 80


def test_every_installed_type_hashes_to_its_installed_hash() -> None:
    files = list(Path(sys.prefix, 'share').glob('*/msg/*.msg'))
    type_names = {f'{file.parents[1].name}/msg/{file.stem}' for file in files}
    assert 'sensor_msgs/msg/Image' in type_names
    for type_name in type_names:
        schema = message_schema(type_name)
        # rosbags hashes char as another type than rosidl does.
        if re.search(r'^char\b', schema.text, re.MULTILINE):
            continue
        # A store that knows nothing but our text; the hash covers every field of every part.
        ours = get_typestore(Stores.EMPTY)
        ours.register(get_types_from_msg(schema.text, type_name))
        assert (schema.encoding, schema.type_hash) == ('ros2msg', ours.hash_rihs01(type_name))


def test_recorded_types_are_those_of_rosbags(
        store: Typestore, samples: dict[str, bytes]) -> None:
    for type_name in samples:
        schema = message_schema(type_name)
        definition, _ = store.generate_msgdef(type_name, ros_version=2)
        assert get_types_from_msg(schema.text, type_name) == get_types_from_msg(
            definition, type_name)
        assert schema.type_hash == store.hash_rihs01(type_name)


def test_text_is_the_installed_file_and_its_dependencies_once() -> None:
    text = message_schema('geometry_msgs/msg/PoseWithCovarianceStamped').text
    parts = text.split(f'\n{LINE}\nMSG: ')
    assert [part.split('\n')[0] for part in parts[1:]] == [
        'geometry_msgs/PoseWithCovariance', 'geometry_msgs/Pose', 'geometry_msgs/Point',
        'geometry_msgs/Quaternion', 'std_msgs/Header', 'builtin_interfaces/Time']
    assert 'Header header' in parts[0] and 'float64[36] covariance' in parts[1]


@pytest.fixture
def overlay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the share folder of an overlay with nothing in it."""
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    return tmp_path / 'share'


def test_types_of_an_overlay(overlay: Path) -> None:
    folder = overlay / 'probe_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Part.msg').write_text('wstring<=5 name\n')
    outer = (
        '# a comment\n\nPart[<=3] parts  # Fake comment\n  std_msgs/Header header\n'
        'string<=4[] words\nstring MARK="# Ghost[] x"\nint32[2] pair [1, 2]\nPart last\n')
    (folder / 'Outer.msg').write_text(outer)
    schema = message_schema('probe_msgs/msg/Outer')
    assert schema.text.startswith(
        f'{outer}\n{LINE}\nMSG: probe_msgs/Part\nwstring<=5 name\n'
        f'\n{LINE}\nMSG: std_msgs/Header\n')
    assert schema.text.count('MSG: ') == 3
    assert (schema.encoding, schema.type_hash) == ('ros2msg', '')


@pytest.mark.parametrize('type_name', [
    'no_msgs/msg/Such', 'sensor_msgs/msg/Such', 'std_srvs/srv/Trigger_Event', 'Image', '',
    '../msg/Image'])
def test_unknown_types_have_an_empty_schema(type_name: str) -> None:
    schema = message_schema(type_name)
    assert (schema.encoding, schema.text, schema.type_hash) == ('', '', '')


def test_a_type_with_an_unknown_part_has_an_empty_schema(overlay: Path) -> None:
    folder = overlay / 'probe_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Outer.msg').write_text('no_msgs/Such part\n')
    assert message_schema('probe_msgs/msg/Outer').encoding == ''
