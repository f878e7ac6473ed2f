"""The packets of a captured stream as a table."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from startracker_ros.table import Result
from startracker_ros.telemetry import nos3, space_packet
from startracker_ros.telemetry.stream import CUT_SHORT, DAMAGED, PacketStream, SKIPPED

_CHUNK_BYTES = 1 << 16


def decode_capture(path: Path, packet_format: str, apid: int) -> Result:
    """Return a row for each packet of a file, ccsds or nos3; OSError."""
    if packet_format == 'nos3':
        stream = PacketStream(nos3.SYNC, nos3.LENGTH, nos3.decode)
        row: Callable[[bytes], Mapping[str, object]] = _nos3_row
    else:
        stream = PacketStream(space_packet.sync(apid), space_packet.LENGTH, space_packet.decode)
        row = _space_packet_row
    packets = [*_packets(path, stream)]
    missing = {} if packet_format == 'nos3' else {
        'packets missing by their sequence': _missing(packets)}
    return Result(f'telemetry decode {packet_format}', [row(packet) for packet in packets], {
        'packets': len(packets), **{name: stream.counts[name] for name in (
            CUT_SHORT, DAMAGED, SKIPPED)}, **missing,
        'last problem': stream.problem or 'none'})


def _packets(path: Path, stream: PacketStream) -> Iterator[bytes]:
    with open(path, 'rb') as file:
        while chunk := file.read(_CHUNK_BYTES):
            yield from stream.feed(chunk)
    stream.finish()


def _nos3_row(packet: bytes) -> Mapping[str, object]:
    quaternion, valid = nos3.decode(packet)
    return {'valid': valid, **{f'q_{axis}': value for axis, value in zip('xyzw', quaternion)}}


def _space_packet_row(packet: bytes) -> Mapping[str, object]:
    found = space_packet.values(packet)
    hidden = {'TIME_CODE', 'TIME_DAY', 'TIME_MS', 'TIME_PS', 'SPARE', 'CHECKSUM'}
    return {'sequence': space_packet.sequence_of(packet),
            'stamp_ns': space_packet.decode(packet).stamp_ns,
            **{name.lower(): value for name, value in found.items() if name not in hidden}}


def _missing(packets: list[bytes]) -> int:
    """Return how many packets the sequence counts leave out."""
    counts = [space_packet.sequence_of(packet) for packet in packets]
    return sum((after - before - 1) % (1 << 14) for before, after in zip(counts, counts[1:]))
