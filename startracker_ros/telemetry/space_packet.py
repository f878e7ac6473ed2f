"""The frame report as a CCSDS space packet (133.0-B-2) of telemetry."""

import binascii
from collections.abc import Mapping
import struct

import numpy as np
from startracker_ros.extras import extra
from startracker_ros.telemetry.packet_fields import DATA_BYTES, FIELDS, TIME_CODE
from startracker_ros.telemetry.report import FrameReport, TelemetryError, TrackerCode

HEADER_BYTES = 6
LENGTH = HEADER_BYTES + DATA_BYTES

_DAY_NS = 86_400_000_000_000
_DAYS_1958_TO_1970 = 4383
_BITS = ('ATTITUDE_VALID', 'RATE_VALID', 'BACKGROUND_VALID', 'TEMPERATURE_VALID', 'SPARE',
         'TRACKER_STATE')
# The bits make one byte.
_LAYOUT = struct.Struct('>BHIIBH4d9fH')
_NAMES = [field.name for field in FIELDS]
_LAST_DAY = 65535


def encode(report: FrameReport, apid: int, sequence: int) -> bytes:
    """
    Return the packet; sequence counts the packets of an apid, modulo 2^14.

    TelemetryError for a stamp that its time cannot hold, MissingLibraryError without
    spacepackets.
    """
    days, within_ns = divmod(report.stamp_ns, _DAY_NS)
    if not 0 <= days + _DAYS_1958_TO_1970 <= _LAST_DAY:
        raise TelemetryError(f'stamp of {report.stamp_ns} ns is outside of 1958 to 2137')
    valid = [report.quaternion is not None, report.rate_rad_s is not None,
             np.isfinite(report.background_dn), np.isfinite(report.temperature_c), False]
    status = sum(int(bit) << 7 - place for place, bit in enumerate(valid)) | report.state
    unknown = np.full(3, np.nan)
    data = _LAYOUT.pack(
        TIME_CODE, days + _DAYS_1958_TO_1970, within_ns // 1_000_000,
        within_ns % 1_000_000 * 1000, status, min(report.stars, 65535),
        *_or(report.quaternion, np.zeros(4)), *_or(report.sigma_rad, unknown),
        *_or(report.rate_rad_s, unknown), report.residual_px, report.background_dn,
        report.temperature_c, 0)
    packet = _header(apid, sequence) + data[:-2]
    return packet + binascii.crc_hqx(packet, 0xFFFF).to_bytes(2, 'big')


def _or(values: np.ndarray | None, otherwise: np.ndarray) -> list[float]:
    return (otherwise if values is None else np.asarray(values, float)).tolist()


def _header(apid: int, sequence: int) -> bytes:
    with extra('telemetry', 'spacepackets', 'A space packet'):
        from spacepackets import SpacePacketHeader
    return bytes(SpacePacketHeader.tm(
        apid, sequence % (1 << 14), DATA_BYTES - 1, sec_header_flag=True).pack())


def sync(apid: int) -> bytes:
    """Return the first two bytes of each packet of an apid."""
    return _header(apid, 0)[:2]


def check(packet: bytes) -> None:
    """Raise TelemetryError for bytes that are no complete packet."""
    if len(packet) != LENGTH:
        raise TelemetryError(f'{len(packet)} bytes, must be {LENGTH}: cut short')
    length = int.from_bytes(packet[4:6], 'big') + 1
    if length != DATA_BYTES:
        raise TelemetryError(f'data length {length} of the header must be {DATA_BYTES}')
    if binascii.crc_hqx(packet, 0xFFFF):
        raise TelemetryError('wrong checksum')


def values(packet: bytes) -> dict[str, int | float]:
    """Return the fields of a packet by name; TelemetryError names what is wrong."""
    check(packet)
    numbers = [*_LAYOUT.unpack(packet[HEADER_BYTES:])]
    status = numbers.pop(_NAMES.index(_BITS[0]))
    bits = [status >> 7 - place & 1 for place in range(5)]
    first = _NAMES.index(_BITS[0])
    return dict(zip(_NAMES, [*numbers[:first], *bits, status & 7, *numbers[first:]]))


def decode(packet: bytes) -> FrameReport:
    """Return the report of a packet; TelemetryError names what is wrong."""
    found = values(packet)
    if found['TIME_CODE'] != TIME_CODE:
        raise TelemetryError(f'time code {found["TIME_CODE"]:#04x} must be {TIME_CODE:#04x}')
    code = int(found['TRACKER_STATE'])
    if code not in {*TrackerCode}:
        raise TelemetryError(f'tracker state {code} is none of {[*map(int, TrackerCode)]}')
    stamp_ns = ((int(found['TIME_DAY']) - _DAYS_1958_TO_1970) * _DAY_NS
                + int(found['TIME_MS']) * 1_000_000 + int(found['TIME_PS']) // 1000)
    valid = bool(found['ATTITUDE_VALID'])
    return FrameReport(
        stamp_ns, _vector(found, 'Q_', 'XYZW') if valid else None,
        _vector(found, 'SIGMA_') if valid else None,
        _vector(found, 'RATE_') if found['RATE_VALID'] else None, TrackerCode(code),
        int(found['STARS']), *(float(found[name]) for name in (
            'RESIDUAL', 'BACKGROUND', 'TEMPERATURE')))


def sequence_of(packet: bytes) -> int:
    """Return the sequence count of a packet."""
    return int.from_bytes(packet[2:4], 'big') & 0x3FFF


def _vector(found: Mapping[str, int | float], prefix: str, axes: str = 'XYZ') -> np.ndarray:
    return np.array([found[f'{prefix}{axis}'] for axis in axes])
