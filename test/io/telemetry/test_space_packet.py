# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The space packet against bytes by hand, and against a reader of its XTCE description."""

from datetime import datetime, timedelta, UTC
import io
from pathlib import Path
import struct

import lxml.etree
import numpy as np
import pytest
import space_packet_parser
from spacepackets.ccsds.time import CdsShortTimestamp
from startracker_ros.io.telemetry import space_packet
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError, TrackerCode
from startracker_ros.io.telemetry.xtce import xtce_text

STAMP_NS = 1_790_000_000_123_456_789
REPORT = FrameReport(
    STAMP_NS, np.array([0.1, -0.5, 0.7, 0.5]), np.array([1e-6, 2e-6, 3e-5]),
    np.array([0.01, -0.02, 0.03]), TrackerCode.TRACKING, 37, 0.06, 71.5, -12.25,
    np.array([6e-6, 1.2e-5, np.inf]))
SCHEMA = Path(space_packet_parser.__file__).parent / 'xtce' / 'schemas' / 'SpaceSystem.xsd'


@pytest.fixture(scope='module')
def packet() -> bytes:
    return space_packet.encode(REPORT, 100, 5)


def test_bytes_by_hand(packet):
    # Version 0, telemetry, secondary header, APID 100; unsegmented, 5; 96 bytes, less one.
    assert packet[:6] == bytes.fromhex('0864 C005 005F')
    assert len(packet) == space_packet.LENGTH == 102
    days, ms, ps = struct.unpack('>HII', packet[7:17])
    assert packet[6] == 0b0_100_0_0_10
    assert datetime(1958, 1, 1, tzinfo=UTC) + timedelta(days=days, milliseconds=ms) == (
        datetime(2026, 9, 21, 14, 13, 20, 123000, UTC))
    assert ps == 456_789_000
    assert packet[17] == 0b1111_0_010
    assert packet[18:20] == b'\x00\x25'
    assert packet[20:52] == struct.pack('>4d', 0.1, -0.5, 0.7, 0.5)
    assert packet[84:88] == struct.pack('>f', -12.25)
    assert packet[88:100] == struct.pack('>3f', 6e-6, 1.2e-5, np.inf)
    # CRC-16/CCITT-FALSE of '123456789' is 0x29B1 by every catalogue of checksums.
    assert space_packet.binascii.crc_hqx(b'123456789', 0xFFFF) == 0x29B1


def test_a_reader_of_the_description_finds_the_same_fields(packet):
    definition = space_packet_parser.load_xtce(io.BytesIO(xtce_text(100).encode()))
    read = definition.parse_bytes(packet)
    ours = space_packet.values(packet)
    names = [name for name in ours if name != 'TRACKER_STATE']
    assert {name: getattr(read[name], 'raw_value', read[name]) for name in names} == {
        name: ours[name] for name in names}
    assert read['TRACKER_STATE'] == 'TRACKING'
    assert (read['PKT_APID'], read['SRC_SEQ_CTR'], read['PKT_LEN']) == (100, 5, 95)


class OfflineXml(lxml.etree.Resolver):
    """The attribute of the namespace xml that the schema uses, instead of a download."""

    def resolve(self, url, public_id, context):
        if url.endswith('/xml.xsd'):
            return self.resolve_string(
                '<schema xmlns="http://www.w3.org/2001/XMLSchema" targetNamespace='
                '"http://www.w3.org/XML/1998/namespace"><attribute name="base" type="anyURI"/>'
                '</schema>', context)
        return None


def test_the_description_keeps_the_schema():
    parser = lxml.etree.XMLParser(no_network=True)
    parser.resolvers.add(OfflineXml())
    text = SCHEMA.read_text()
    schema = lxml.etree.XMLSchema(lxml.etree.fromstring(text.encode(), parser))
    schema.assertValid(lxml.etree.fromstring(xtce_text(7).encode()))


def test_a_report_survives(packet):
    back = space_packet.decode(packet)
    assert back.stamp_ns == STAMP_NS
    assert (back.quaternion == REPORT.quaternion).all()
    assert back.rate_rad_s == pytest.approx(REPORT.rate_rad_s, rel=1e-7)
    assert back.sigma_rad == pytest.approx(REPORT.sigma_rad, rel=1e-7)
    assert back.protection_rad == pytest.approx(REPORT.protection_rad, rel=1e-7)
    assert (back.state, back.stars) == (TrackerCode.TRACKING, 37)
    assert (back.background_dn, back.temperature_c) == (71.5, -12.25)
    assert space_packet.sequence_of(packet) == 5
    assert space_packet.sequence_of(space_packet.encode(REPORT, 100, 16384 + 3)) == 3
    assert space_packet.encode(back, 100, 5) == packet


def test_what_is_not_known_is_flagged():
    packet = space_packet.encode(FrameReport(STAMP_NS), 0, 0)
    found = space_packet.values(packet)
    assert packet[17] == 0b0000_0_111
    assert not any(found[f'Q_{axis}'] for axis in 'XYZW')
    assert all(np.isnan(found[f'{name}_{axis}']) for axis in 'XYZ'
               for name in ('SIGMA', 'RATE', 'PROTECTION'))
    back = space_packet.decode(packet)
    assert back.quaternion is None and back.rate_rad_s is None and back.protection_rad is None
    assert back.state is TrackerCode.UNKNOWN


@pytest.mark.parametrize('stamp_ns', [
    -4383 * 86_400_000_000_000 - 1, (65535 - 4383 + 1) * 86_400_000_000_000])
def test_a_stamp_that_does_not_fit_is_named(stamp_ns):
    with pytest.raises(TelemetryError, match='outside of 1958 to 2137'):
        space_packet.encode(FrameReport(stamp_ns), 0, 0)


def test_damage_is_named(packet):
    for length in (0, 5, 101):
        with pytest.raises(TelemetryError, match=f'{length} bytes, must be 102: cut short'):
            space_packet.decode(packet[:length])
    for place in range(6, 102):
        wrong = bytearray(packet)
        wrong[place] ^= 1
        with pytest.raises(TelemetryError, match='wrong checksum'):
            space_packet.decode(bytes(wrong))
    with pytest.raises(TelemetryError, match='data length 97'):
        space_packet.decode(packet[:5] + b'\x60' + packet[6:])


@pytest.mark.parametrize(('begin', 'data', 'words'), [
    (6, b'\x41', 'time code 0x41'), (9, b'\x05\x26\x60\xe8', '86401256 ms'),
    (13, b'\x3b\x9a\xca\x00', '1000000000 ps'), (17, b'\x83', 'tracker state 3'),
    (20, bytes(32), 'is not a rotation')])
def test_what_is_wrong_in_spite_of_its_checksum_is_named(packet, begin, data, words):
    wrong = bytearray(packet)
    wrong[begin:begin + len(data)] = data
    wrong[100:] = space_packet.binascii.crc_hqx(bytes(wrong[:100]), 0xFFFF).to_bytes(2, 'big')
    with pytest.raises(TelemetryError, match=words):
        space_packet.decode(bytes(wrong))


def test_both_signs_of_a_quaternion_are_kept():
    for sign in (1, -1):
        back = space_packet.decode(space_packet.encode(
            FrameReport(STAMP_NS, sign * REPORT.quaternion), 100, 0))
        assert (back.quaternion == sign * REPORT.quaternion).all()


def test_what_a_field_cannot_hold_is_named():
    with pytest.raises(TelemetryError, match=r'TEMPERATURE = 1e\+300 does not fit 32 bits'):
        space_packet.encode(FrameReport(STAMP_NS, temperature_c=1e300), 100, 0)
    with pytest.raises(TelemetryError, match='STARS = -3 does not fit 16 bits'):
        space_packet.encode(FrameReport(STAMP_NS, stars=-3), 100, 0)
    most = space_packet.encode(FrameReport(STAMP_NS, stars=70_000), 100, 0)
    assert space_packet.decode(most).stars == 65535


def test_the_time_is_that_of_another_library():
    packet = space_packet.encode(FrameReport(STAMP_NS), 100, 0)
    other = CdsShortTimestamp.from_datetime(datetime.fromtimestamp(STAMP_NS // 10 ** 9, UTC))
    days, ms = struct.unpack('>HI', other.pack()[1:])
    # Its P-field has no digits below the millisecond.
    assert packet[6] & 0xFC == other.pack()[0]
    assert struct.unpack('>HI', packet[7:13]) == (days, ms + 123)
