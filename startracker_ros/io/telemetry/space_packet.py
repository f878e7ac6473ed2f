# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The frame report as a CCSDS space packet (133.0-B-2) of telemetry."""

import binascii
from collections.abc import Iterator, Mapping
import math
import re
import struct
from typing import NamedTuple

import numpy as np
from startracker_ros.core.extras import extra
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError, TrackerCode


# --- the fields: the one table of encoder, decoder and XTCE ---

class Field(NamedTuple):
    """A field of kind uint or float: name, bits, unit, meaning."""

    name: str
    kind: str
    bits: int
    unit: str
    meaning: str


TIME_CODE = 0x42
"""P-field of CDS: epoch 1958, 16 bits of days, 32 bits of picoseconds (CCSDS 301.0-B-4, 3.3)."""

PRIMARY_HEADER = (
    Field('VERSION', 'uint', 3, '', 'packet version number'),
    Field('TYPE', 'uint', 1, '', '0: telemetry'),
    Field('SEC_HDR_FLG', 'uint', 1, '', '1: with a secondary header'),
    Field('PKT_APID', 'uint', 11, '', 'application process identifier'),
    Field('SEQ_FLGS', 'uint', 2, '', '3: unsegmented'),
    Field('SRC_SEQ_CTR', 'uint', 14, '', 'sequence count'),
    Field('PKT_LEN', 'uint', 16, '', 'bytes behind this header, less one'))

FIELDS = (
    Field('TIME_CODE', 'uint', 8, '', f'P-field of the time, {TIME_CODE:#04x}: CDS, picoseconds'),
    Field('TIME_DAY', 'uint', 16, 'd', 'days since 1958-01-01, UTC'),
    Field('TIME_MS', 'uint', 32, 'ms', 'milliseconds of the day'),
    Field('TIME_PS', 'uint', 32, 'ps', 'picoseconds of the millisecond'),
    Field('ATTITUDE_VALID', 'uint', 1, '', '1: the attitude is trusted'),
    Field('RATE_VALID', 'uint', 1, '', '1: the rate is known'),
    Field('BACKGROUND_VALID', 'uint', 1, '', '1: the background is known'),
    Field('TEMPERATURE_VALID', 'uint', 1, '', '1: the temperature is known'),
    Field('SPARE', 'uint', 1, '', '0'),
    Field('TRACKER_STATE', 'uint', 3, '', '0 LOST, 1 ACQUIRING, 2 TRACKING, 7 UNKNOWN'),
    Field('STARS', 'uint', 16, '', 'stars matched'),
    *(Field(f'Q_{axis}', 'float', 64, '', f'{axis.lower()} of q_icrf_from_sensor; all four are 0 '
            'without a trusted attitude') for axis in 'XYZW'),
    *(Field(f'SIGMA_{axis}', 'float', 32, 'rad', f'1-sigma error about sensor {axis.lower()}')
      for axis in 'XYZ'),
    *(Field(f'RATE_{axis}', 'float', 32, 'rad/s', f'angular velocity about sensor {axis.lower()}')
      for axis in 'XYZ'),
    Field('RESIDUAL', 'float', 32, 'px', 'rms residual of the stars'),
    Field('BACKGROUND', 'float', 32, 'DN', 'median background of the image'),
    Field('TEMPERATURE', 'float', 32, 'Cel', 'temperature of the detector'),
    *(Field(f'PROTECTION_{axis}', 'float', 32, 'rad', 'protection level, bound of the error about '
            f'sensor {axis.lower()}; infinite where there is none') for axis in 'XYZ'),
    Field('CHECKSUM', 'uint', 16, '', 'CRC-16/CCITT (0x1021, from 0xFFFF) of all bytes before'),
)
"""Behind the primary header of 6 bytes; big-endian. The first four are the secondary header. NaN
where a float is not known."""

DATA_BYTES = sum(field.bits for field in FIELDS) // 8
"""Length of the packet without its primary header."""

_FLOATS = {32: struct.Struct('>f'), 64: struct.Struct('>d')}


def pack(values: Mapping[str, int | float]) -> bytes:
    """Return FIELDS as bytes; TelemetryError names a value that its field cannot hold."""
    number = 0
    for field in FIELDS:
        number = number << field.bits | _encoded(field, values[field.name])
    return number.to_bytes(DATA_BYTES, 'big')


def unpack(data: bytes) -> dict[str, int | float]:
    """Return the values of FIELDS by name; data has DATA_BYTES."""
    number, left, values = int.from_bytes(data, 'big'), 8 * DATA_BYTES, {}
    for field in FIELDS:
        left -= field.bits
        values[field.name] = _decoded(field, number >> left & (1 << field.bits) - 1)
    return values


def _encoded(field: Field, value: int | float) -> int:
    try:
        if field.kind == 'float':
            return int.from_bytes(_FLOATS[field.bits].pack(value), 'big')
        if not 0 <= int(value) < 1 << field.bits:
            raise OverflowError
        return int(value)
    except OverflowError:
        raise TelemetryError(f'{field.name} = {value} does not fit {field.bits} bits') from None


def _decoded(field: Field, number: int) -> int | float:
    if field.kind == 'uint':
        return number
    return float(_FLOATS[field.bits].unpack(number.to_bytes(field.bits // 8, 'big'))[0])


# --- the packet ---

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
    """Raise TelemetryError for bytes that are not a complete packet."""
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
            f'{found["TIME_MS"]} ms and {found["TIME_PS"]} ps are not a time of day')
    code = int(found['TRACKER_STATE'])
    if code not in {*TrackerCode}:
        raise TelemetryError(f'tracker state {code} is not one of {[*map(int, TrackerCode)]}')
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
