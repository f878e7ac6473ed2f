# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a bag, version 9 (rosbag2 of Jazzy)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from startracker_ros.io.bags.qos import QosProfile
import yaml

# The start of a bag without messages, as rosbag2 writes it.
_NEVER_NS = 2 ** 63 - 1


@dataclass
class TopicRecord:
    """One topic of a bag, and how many messages it has so far."""

    name: str
    type_name: str
    type_hash: str
    qos: tuple[QosProfile, ...]
    encoding: str = 'cdr'
    message_count: int = 0


@dataclass
class FileRecord:
    """One file of a bag: how many messages it has so far, and their first and last log time."""

    name: str
    message_count: int = 0
    span_ns: tuple[int, int] | None = None

    def count(self, log_time_ns: int) -> None:
        """Add a message."""
        start_ns, end_ns = self.span_ns or (log_time_ns, log_time_ns)
        self.span_ns = min(start_ns, log_time_ns), max(end_ns, log_time_ns)
        self.message_count += 1


def bag_information(files: Sequence[FileRecord], topics: Sequence[TopicRecord]) -> dict[str, Any]:
    """Return the metadata of a bag of these files."""
    spans = [file.span_ns for file in files if file.span_ns]
    span_ns = (min(start for start, _ in spans), max(end for _, end in spans)) if spans else None
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **_duration(span_ns),
        **_start(span_ns),
        'message_count': sum(file.message_count for file in files),
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name,
                'type': topic.type_name,
                'serialization_format': topic.encoding,
                'offered_qos_profiles': [profile.as_dict() for profile in topic.qos],
                'type_description_hash': topic.type_hash,
            },
            'message_count': topic.message_count,
        } for topic in topics],
        # Of complete files or single messages; chunks are compressed by MCAP.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [{
            'path': file.name,
            **_start(file.span_ns),
            **_duration(file.span_ns),
            'message_count': file.message_count,
        } for file in files],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def _start(span_ns: tuple[int, int] | None) -> dict[str, Any]:
    start_ns = span_ns[0] if span_ns else _NEVER_NS
    return {'starting_time': {'nanoseconds_since_epoch': start_ns}}


def _duration(span_ns: tuple[int, int] | None) -> dict[str, Any]:
    duration_ns = span_ns[1] - span_ns[0] if span_ns else 0
    return {'duration': {'nanoseconds': duration_ns}}


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
