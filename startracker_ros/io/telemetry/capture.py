# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Packets found in a captured stream by how they begin, checked, as a table."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from startracker_ros.io.table import Result
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.report import TelemetryError

_COUNTS = 1 << 14
"""Sequence counts are modulo this."""

CUT_SHORT, DAMAGED, SKIPPED = 'packets cut short', 'packets damaged', 'bytes between packets'


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


class PacketStream:
    """
    Splits bytes into packets of one length that begin with sync; check raises TelemetryError.

    counts has what was not a packet: a packet cut short, that is with the beginning of the next
    one within its length or with the end of the stream, a damaged one, and bytes in between.
    problem is the text of the last error.
    """

    def __init__(self, sync: bytes, length: int, check: Callable[[bytes], object]) -> None:
        self._sync, self._length, self._check = sync, length, check
        self._buffer = bytearray()
        self.counts: Counter[str] = Counter()
        self.problem = ''

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the packets that are complete with these bytes."""
        self._buffer += data
        while True:
            self._skip_to_sync()
            if len(self._buffer) < self._length:
                return
            packet = bytes(self._buffer[:self._length])
            try:
                self._check(packet)
            except TelemetryError as error:
                last = self._length + len(self._sync) - 1
                cut_short = self._buffer.find(self._sync, 1, last) > 0
                self.counts[CUT_SHORT if cut_short else DAMAGED] += 1
                self.problem = f'{"cut short" if cut_short else "damaged"}: {error}'
                # Not the whole length: the next packet may begin within.
                del self._buffer[:len(self._sync)]
                self._skip_to_sync(of_a_packet=True)
            else:
                del self._buffer[:self._length]
                yield packet

    def finish(self) -> None:
        """Count what the end of the stream leaves over."""
        if self._buffer.startswith(self._sync):
            self.counts[CUT_SHORT] += 1
            self.problem = f'cut short: {len(self._buffer)} of {self._length} bytes at the end'
        elif self._buffer:
            self.counts[SKIPPED] += len(self._buffer)
        self._buffer.clear()

    def _skip_to_sync(self, of_a_packet: bool = False) -> None:
        """Drop what is before the next beginning; it counts unless it is of a damaged packet."""
        begin = self._buffer.find(self._sync)
        if begin < 0:
            # The last byte may be the first of a beginning.
            keep = self._buffer.endswith(self._sync[:1])
            begin = len(self._buffer) - keep
        if not of_a_packet:
            self.counts[SKIPPED] += begin
        del self._buffer[:begin]
