# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The packet of NOS3 against the definitions of its flight software and of the simulator 42."""

import ctypes

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_ros.io.telemetry import nos3
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError

Q = np.array([0.1826, -0.3651, 0.5477, 0.7303]) / np.linalg.norm([0.1826, -0.3651, 0.5477, 0.7303])


class Reply(ctypes.BigEndianStructure):
    """As create_generic_star_tracker_data() of the simulator of NOS3 fills its 13 bytes."""

    _pack_ = 1
    _layout_ = 'ms'
    _fields_ = [('header', ctypes.c_uint16), ('q', ctypes.c_uint16 * 4),
                ('valid', ctypes.c_uint8), ('trailer', ctypes.c_uint16)]


def flight_software(packet: bytes) -> tuple[list[float], int]:
    """Read as GENERIC_STAR_TRACKER_RequestData() does, byte by byte."""
    assert (packet[0], packet[1], packet[11], packet[12]) == (0xDE, 0xAD, 0xBE, 0xEF)
    return ([((packet[i] << 8 | packet[i + 1]) - 32768.0) / 32767.0 for i in (2, 4, 6, 8)],
            packet[10])


def cosines_of_42(q: list[float]) -> np.ndarray:
    """Return the matrix, sensor from inertial, of Q2C() in dcmkit.c of 42."""
    a, b, c, d = q
    return np.array([
        [1 - 2 * (b * b + c * c), 2 * (a * b + c * d), 2 * (a * c - b * d)],
        [2 * (a * b - c * d), 1 - 2 * (c * c + a * a), 2 * (b * c + a * d)],
        [2 * (a * c + b * d), 2 * (b * c - a * d), 1 - 2 * (a * a + b * b)]])


def test_bytes_by_hand():
    packet = bytes.fromhex('DEAD 8000 FFFF 0001 C000 01 BEEF')
    assert nos3.encode(FrameReport(0)) == bytes.fromhex('DEAD 8000 8000 8000 8000 00 BEEF')
    assert nos3.encode(FrameReport(0, np.array([0, 1.0, 0, 0]))) == bytes.fromhex(
        'DEAD 8000 FFFF 8000 8000 01 BEEF')
    quaternion, valid = nos3.decode(packet)
    assert valid
    assert quaternion.tolist() == [0.0, 1.0, -1.0, 16384 / 32767]
    assert flight_software(packet) == (quaternion.tolist(), 1)


def test_every_number_survives_decoding_and_encoding():
    numbers = np.arange(65536)
    components = (numbers - 32768.0) / 32767.0
    assert (np.rint(components * 32767) + 32768 == numbers).all()
    for sign in (1, -1):
        packet = nos3.encode(FrameReport(0, sign * Q))
        assert len(packet) == ctypes.sizeof(Reply) == nos3.LENGTH == 13
        seen = Reply.from_buffer_copy(packet)
        assert (seen.header, seen.valid, seen.trailer) == (0xDEAD, 1, 0xBEEF)
        # The simulator of NOS3 truncates.
        truncated = (sign * Q * 32767.0 + 32768.0).astype(np.uint16)
        assert (np.array(seen.q, int) - truncated <= 1).all()
        assert (np.array(seen.q, int) - truncated >= 0).all()


def test_the_rotation_is_that_of_42_within_a_step():
    numbers, valid = flight_software(nos3.encode(FrameReport(0, Q)))
    assert valid == 1
    ours = Rotation.from_quat(Q).as_matrix()
    apart = Rotation.from_matrix(cosines_of_42(numbers).T @ ours.T).magnitude()
    assert apart * 180 * 3600 / np.pi < 12.6
    assert np.abs(cosines_of_42(numbers) - ours).max() > 0.5


def test_an_untrusted_attitude_is_not_a_rotation():
    quaternion, valid = nos3.decode(nos3.encode(FrameReport(0)))
    assert not valid
    assert not quaternion.any()
    for wrong in (np.zeros(4), np.full(4, np.nan), np.array([0, 0, 0, 2.0])):
        with pytest.raises(TelemetryError, match='is not a rotation'):
            FrameReport(0, wrong)


@pytest.mark.parametrize(('packet', 'words'), [
    ('DEAD 8000 FFFF 0001 C000 01 BE', '12 bytes, must be 13: cut short'),
    ('', '0 bytes'),
    ('DEAF 8000 FFFF 0001 C000 01 BEEF', 'header 0xdeaf'),
    ('DEAD 8000 FFFF 0001 C000 01 BEEE', 'trailer 0xbeee'),
    ('DEAD 8000 FFFF 0001 C000 02 BEEF', 'valid flag 2')])
def test_what_is_not_a_packet_is_named(packet, words):
    with pytest.raises(TelemetryError, match=words):
        nos3.decode(bytes.fromhex(packet))
