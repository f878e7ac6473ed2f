# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The frame report as a CCSDS space packet (133.0-B-2) of telemetry."""

import binascii
from collections.abc import Iterator, Mapping
import math
import re

import numpy as np
from startracker_ros.core.extras import extra
from startracker_ros.io.telemetry.packet_fields import DATA_BYTES, pack, TIME_CODE, unpack
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError, TrackerCode

HEADER_BYTES = 6
LENGTH = HEADER_BYTES + DATA_BYTES

_DAY_NS = 86_400_000_000_000
_DAYS_1958_TO_1970 = 4383
_LAST_DAY = _MOST_STARS = 65535
_LONGEST_DAY_MS = 86_401_000
"""With a leap second."""

# Telemetry with a secondary header, unsegmented, of this length; one may begin within another.
_ANY_PACKET = re.compile(b'(?s)(?=[\x08-\x0f].[\xc0-\xff].%b.{%d})' % (
    re.escape((DATA_BYTES - 1).to_bytes(2, 'big')), DATA_BYTES))


def encode(report: FrameReport, apid: int, sequence: int) -> bytes:
    """
    Return the packet; sequence counts the packets of an apid, modulo 2^14.

    TelemetryError for what its fields cannot hold, MissingLibraryError without spacepackets.
    """
    days, within_ns = divmod(report.stamp_ns, _DAY_NS)
    if not 0 <= days + _DAYS_1958_TO_1970 <= _LAST_DAY:
        raise TelemetryError(f'stamp of {report.stamp_ns} ns is outside of 1958 to 2137')
    q, unknown = report.quaternion, np.full(3, np.nan)
    data = pack({
        'TIME_CODE': TIME_CODE, 'TIME_DAY': days + _DAYS_1958_TO_1970,
        'TIME_MS': within_ns // 1_000_000, 'TIME_PS': within_ns % 1_000_000 * 1000,
        'ATTITUDE_VALID': q is not None, 'RATE_VALID': report.rate_rad_s is not None,
        'BACKGROUND_VALID': np.isfinite(report.background_dn),
        'TEMPERATURE_VALID': np.isfinite(report.temperature_c), 'SPARE': 0,
        'TRACKER_STATE': report.state, 'STARS': min(report.stars, _MOST_STARS),
        **_named('Q_', np.zeros(4) if q is None else q, 'XYZW'),
        **_named('SIGMA_', unknown if report.sigma_rad is None else report.sigma_rad),
        **_named('RATE_', unknown if report.rate_rad_s is None else report.rate_rad_s),
        'RESIDUAL': report.residual_px, 'BACKGROUND': report.background_dn,
        'TEMPERATURE': report.temperature_c,
        **_named('PROTECTION_', unknown if report.protection_rad is None
                 else report.protection_rad), 'CHECKSUM': 0})
    packet = _header(apid, sequence) + data[:-2]
    return packet + binascii.crc_hqx(packet, 0xFFFF).to_bytes(2, 'big')


def _named(prefix: str, values: np.ndarray, axes: str = 'XYZ') -> dict[str, float]:
    return {f'{prefix}{axis}': float(value) for axis, value in zip(axes, values)}


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
    return unpack(packet[HEADER_BYTES:])


def decode(packet: bytes) -> FrameReport:
    """Return the report of a packet; TelemetryError names what is wrong."""
    found = values(packet)
    if found['TIME_CODE'] != TIME_CODE:
        raise TelemetryError(f'time code {found["TIME_CODE"]:#04x} must be {TIME_CODE:#04x}')
    if found['TIME_MS'] >= _LONGEST_DAY_MS or found['TIME_PS'] >= 10 ** 9:
        raise TelemetryError(
            f'{found["TIME_MS"]} ms and {found["TIME_PS"]} ps are no time of a day')
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
        int(found['STARS']), found['RESIDUAL'], found['BACKGROUND'], found['TEMPERATURE'],
        _vector(found, 'PROTECTION_') if not math.isnan(found['PROTECTION_X']) else None)


def apids(data: bytes) -> Iterator[int]:
    """Yield the apid of each intact packet in some bytes, whichever it is."""
    for found in _ANY_PACKET.finditer(data):
        packet = data[found.start():found.start() + LENGTH]
        if not binascii.crc_hqx(packet, 0xFFFF):
            yield int.from_bytes(packet[:2], 'big') & 0x7FF


def sequence_of(packet: bytes) -> int:
    """Return the sequence count of a packet."""
    return int.from_bytes(packet[2:4], 'big') & 0x3FFF


def _vector(found: Mapping[str, int | float], prefix: str, axes: str = 'XYZ') -> np.ndarray:
    return np.array([found[f'{prefix}{axis}'] for axis in axes])
