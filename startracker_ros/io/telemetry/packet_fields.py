# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fields of the space packet: the one table of encoder, decoder and XTCE."""

from collections.abc import Mapping
import struct
from typing import NamedTuple

from startracker_ros.io.telemetry.report import TelemetryError


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
