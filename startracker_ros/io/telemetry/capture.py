# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The packets of a captured stream as a table."""

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from startracker_ros.io.table import Result
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.stream import CUT_SHORT, DAMAGED, PacketStream, SKIPPED

_COUNTS = 1 << 14
"""Sequence counts are modulo this."""


def decode_capture(path: Path, packet_format: str, apid: int) -> Result:
    """Return a row for each packet of a file, ccsds or nos3; OSError."""
    data = path.read_bytes()
    if packet_format == 'nos3':
        stream = PacketStream(nos3.SYNC, nos3.LENGTH, nos3.decode)
        row: Callable[[bytes], Mapping[str, object]] = _nos3_row
    else:
        stream = PacketStream(space_packet.sync(apid), space_packet.LENGTH, space_packet.decode)
        row = _space_packet_row
    packets = [*stream.feed(data)]
    stream.finish()
    return Result(f'telemetry decode {packet_format}', [row(packet) for packet in packets], {
        'packets': len(packets), **{name: stream.counts[name] for name in (
            CUT_SHORT, DAMAGED, SKIPPED)},
        **({} if packet_format == 'nos3' else _conditions(packets, data, apid)),
        'last problem': stream.problem or 'none'})


def _conditions(packets: list[bytes], data: bytes, apid: int) -> Mapping[str, object]:
    """Return what the headers of space packets tell besides."""
    missing, back = _steps([space_packet.sequence_of(packet) for packet in packets])
    others = Counter(each for each in space_packet.apids(data) if each != apid)
    return {'packets missing by their sequence': missing, 'steps back of the sequence': back,
            'packets of other apids': ', '.join(
                f'{count} of {each}' for each, count in sorted(others.items())) or 'none'}


def _steps(counts: list[int]) -> tuple[int, int]:
    """
    Return how many packets the sequence counts leave out, and how often they step back.

    A step by less than half of the range is one ahead. A packet that comes twice or late, and a
    sender that starts again, step back.
    """
    ahead = [(after - before - 1) % _COUNTS for before, after in zip(counts, counts[1:])]
    return (sum(step for step in ahead if step < _COUNTS // 2),
            sum(step >= _COUNTS // 2 for step in ahead))


def _nos3_row(packet: bytes) -> Mapping[str, object]:
    quaternion, valid = nos3.decode(packet)
    return {'valid': valid, **{f'q_{axis}': value for axis, value in zip('xyzw', quaternion)}}


def _space_packet_row(packet: bytes) -> Mapping[str, object]:
    found = space_packet.values(packet)
    hidden = {'TIME_CODE', 'TIME_DAY', 'TIME_MS', 'TIME_PS', 'SPARE', 'CHECKSUM'}
    return {'sequence': space_packet.sequence_of(packet),
            'stamp_ns': space_packet.decode(packet).stamp_ns,
            **{name.lower(): value for name, value in found.items() if name not in hidden}}
