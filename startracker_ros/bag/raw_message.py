"""A message of a bag before its topic is looked at."""

from dataclasses import dataclass

from mcap.records import Channel, Schema


@dataclass(frozen=True)
class RawMessage:
    """A message as it stands in the file."""

    channel: Channel
    schema: Schema | None
    log_time_ns: int
    publish_time_ns: int
    data: bytes
