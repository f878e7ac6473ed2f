# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of the bags of a run, whose files come from many workers."""

from collections.abc import Iterable
from pathlib import Path

from startracker_ros.io.bags.mcap_file import McapFile
from startracker_ros.io.bags.metadata import bag_information, FileRecord, to_yaml, TopicRecord
from startracker_ros.io.bags.qos import qos_from_yaml
from startracker_ros.io.output import write_output
from startracker_ros.tools.reprocess.work import SegmentRecord


def write_metadata(folder: Path, records: Iterable[SegmentRecord]) -> None:
    """Write metadata.yaml into each bag folder of a run, with its files in the order of time."""
    files: dict[Path, list[Path]] = {}
    for record in records:
        for name in record.files:
            if name.endswith('.mcap'):
                files.setdefault((folder / name).parent, []).append(folder / name)
    for bag, paths in files.items():
        information = _information(paths)
        write_output(bag / 'metadata.yaml',
                     to_yaml({'rosbag2_bagfile_information': information}))


def _information(paths: list[Path]) -> dict:
    """Return the metadata of a bag of these files."""
    topics: dict[str, TopicRecord] = {}
    found = []
    for path in paths:
        with McapFile(path) as file:
            counts = file.statistics.channel_message_counts if file.statistics else {}
            found.append(FileRecord(path.name, sum(counts.values()), file.span_ns))
            for channel in file.channels.values():
                schema = file.schemas[channel.schema_id]
                topic = topics.setdefault(channel.topic, TopicRecord(
                    channel.topic, schema.name, channel.metadata['topic_type_hash'],
                    qos_from_yaml(channel.metadata['offered_qos_profiles'])))
                topic.message_count += counts.get(channel.id, 0)
    found.sort(key=lambda record: record.span_ns or (0, 0))
    return bag_information(found, list(topics.values()))
