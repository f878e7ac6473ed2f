# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A message of a bag before its topic is looked at."""

from array import array
from collections.abc import Iterable
from typing import NamedTuple

from mcap.records import Channel, Schema
import numpy as np
from numpy.typing import ArrayLike


class RawMessage(NamedTuple):
    """A message as it stands in the file."""

    channel: Channel
    schema: Schema | None
    log_time_ns: int
    publish_time_ns: int
    data: bytes


def absolute(topic: str) -> str:
    """Return the full name of a topic; some recorders leave out the slash before it."""
    return topic if topic.startswith('/') else f'/{topic}'


def by_channel(times: Iterable[tuple[int, ArrayLike]]) -> dict[int, np.ndarray]:
    """Return log times (N,) by channel of pieces of them."""
    found: dict[int, array] = {}
    for number, piece in times:
        found.setdefault(number, array('Q')).frombytes(np.asarray(piece, np.uint64).tobytes())
    return {number: np.asarray(column) for number, column in found.items()}
