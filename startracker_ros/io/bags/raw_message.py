# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A message of a bag before its topic is looked at."""

from typing import NamedTuple

from mcap.records import Channel, Schema


class RawMessage(NamedTuple):
    """A message as it stands in the file."""

    channel: Channel
    schema: Schema | None
    log_time_ns: int
    publish_time_ns: int
    data: bytes
