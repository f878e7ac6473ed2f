"""metadata.yaml of a bag, version 9 (rosbag2 of Jazzy)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from startracker_ros.bag.qos import QosProfile

# What rosbag2 notes as the start of a bag without messages.
_NEVER_NS = 2 ** 63 - 1


@dataclass
class TopicRecord:
    """One topic of a bag, and how many messages it has so far."""

    name: str
    type_name: str
    type_hash: str
    qos: tuple[QosProfile, ...]
    message_count: int = 0


def bag_information(file_name: str, topics: Sequence[TopicRecord],
                    span_ns: tuple[int, int] | None) -> dict[str, Any]:
    """Return the metadata of a bag of one file; span_ns is its first and last log time."""
    start_ns, end_ns = span_ns or (_NEVER_NS, _NEVER_NS)
    message_count = sum(topic.message_count for topic in topics)
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end_ns - start_ns},
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'message_count': message_count,
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name,
                'type': topic.type_name,
                'serialization_format': 'cdr',
                'offered_qos_profiles': [profile.as_dict() for profile in topic.qos],
                'type_description_hash': topic.type_hash,
            },
            'message_count': topic.message_count,
        } for topic in topics],
        # Of whole files or messages; MCAP compresses its chunks by itself.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file_name],
        'files': [{
            'path': file_name,
            'starting_time': {'nanoseconds_since_epoch': start_ns},
            'duration': {'nanoseconds': end_ns - start_ns},
            'message_count': message_count,
        }],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def to_yaml(value: Any) -> str:
    """Return YAML in the layout of rosbag2, without the last newline."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=False,
                     width=2 ** 16).rstrip('\n')


class _Dumper(yaml.SafeDumper):
    """Lists indented below their key, ~ for nothing, "" for an empty string."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    type(None), lambda dumper, value: dumper.represent_scalar('tag:yaml.org,2002:null', '~'))
_Dumper.add_representer(
    str, lambda dumper, value: dumper.represent_scalar(
        'tag:yaml.org,2002:str', value, style=None if value else '"'))
