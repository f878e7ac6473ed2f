# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The reply of the generic star tracker of NASA's NOS3 to a request for data: 13 bytes.

    offset  type    content
    0       uint16  0xDEAD
    2       uint16  Q0, as all numbers big-endian
    4       uint16  Q1
    6       uint16  Q2
    8       uint16  Q3
    10      uint8   1 where the quaternion is valid, else 0
    11      uint16  0xBEEF

A component is (number - 32768) / 32767 (nasa-itc/generic_star_tracker,
fsw/shared/generic_star_tracker_device.c). Q0 to Q3 are the qn of the simulator 42, x, y, z, w: its
direction cosine matrix Q2C(qn), sensor from inertial, is the transpose of R(q_icrf_from_sensor).
The components are ours unchanged. A step of a component is a turn of 2 / 32767 rad, 12.6 arcsec.
The packet has no time.
"""

import struct

import numpy as np
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError

SYNC = b'\xde\xad'
LENGTH = 13

_LAYOUT = struct.Struct('>H4HBH')
_HEADER, _TRAILER = 0xDEAD, 0xBEEF
_ZERO, _SCALE = 32768, 32767


def encode(report: FrameReport) -> bytes:
    """
    Return the packet; without a trusted attitude the quaternion is zero, which is not a rotation.

    Numbers are rounded to the nearest; the simulator of NOS3 truncates, which is at most one less.
    """
    q = np.zeros(4) if report.quaternion is None else report.quaternion
    numbers = np.rint(np.asarray(q, float) * _SCALE).astype(int) + _ZERO
    return _LAYOUT.pack(_HEADER, *numbers.tolist(), int(report.quaternion is not None), _TRAILER)


def decode(packet: bytes) -> tuple[np.ndarray, bool]:
    """Return the quaternion (4,), not normalised, and whether it is valid; TelemetryError."""
    if len(packet) != LENGTH:
        raise TelemetryError(f'{len(packet)} bytes, must be {LENGTH}: cut short')
    header, *numbers, valid, trailer = _LAYOUT.unpack(packet)
    if (header, trailer) != (_HEADER, _TRAILER):
        raise TelemetryError(f'header {header:#06x} and trailer {trailer:#06x} are not '
                             f'{_HEADER:#06x} and {_TRAILER:#06x}')
    if valid > 1:
        raise TelemetryError(f'valid flag {valid} is neither 0 nor 1')
    return (np.array(numbers) - _ZERO) / _SCALE, bool(valid)
