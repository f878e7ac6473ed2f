# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Packets out of a stream of bytes: found by how they begin, checked, damage named and counted."""

from collections import Counter
from collections.abc import Callable, Iterator

from startracker_ros.io.telemetry.report import TelemetryError

CUT_SHORT, DAMAGED, SKIPPED = 'packets cut short', 'packets damaged', 'bytes between packets'


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
