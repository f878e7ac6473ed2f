# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Streams of packets with damage, links, and the commands on a capture."""

import json
import os
import pty
import socket

from commands import invoke
from limits import HANGS_S
import numpy as np
import pytest
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.capture import (
    CUT_SHORT, DAMAGED, decode_capture, PacketStream, SKIPPED)
from startracker_ros.io.telemetry.link import Link, LinkError
from startracker_ros.io.telemetry.report import FrameReport

Q = np.array([0.1, -0.5, 0.7, 0.5])
# Every second packet has the beginning of a packet among its numbers: 0xDEAD as Q3.
TRAP = np.array([0, 0, np.sqrt(1 - (0x5EAD / 32767) ** 2), 0x5EAD / 32767])


def nos3_stream() -> PacketStream:
    return PacketStream(nos3.SYNC, nos3.LENGTH, nos3.decode)


def space_stream() -> PacketStream:
    return PacketStream(space_packet.sync(100), space_packet.LENGTH, space_packet.decode)


PACKETS = {
    nos3_stream: [nos3.encode(FrameReport(0, q)) for q in (Q, TRAP, Q, -TRAP)],
    space_stream: [space_packet.encode(FrameReport(number, Q), 100, number)
                   for number in range(4)]}


@pytest.mark.parametrize('make', PACKETS)
@pytest.mark.parametrize('step', [1, 7, 1000])
def test_whole_packets_are_found_whatever_the_pieces(make, step):
    stream, data = make(), b'xyz' + b''.join(PACKETS[make]) + b'\x00'
    found = [packet for begin in range(0, len(data), step)
             for packet in stream.feed(data[begin:begin + step])]
    stream.finish()
    assert found == PACKETS[make]
    assert stream.counts == {SKIPPED: 4}


@pytest.mark.parametrize('make', PACKETS)
def test_a_packet_cut_short_is_counted_and_the_next_ones_are_found(make):
    first, second, third, fourth = PACKETS[make]
    for length in range(2, len(second)):
        stream = make()
        found = [*stream.feed(first + second[:length] + third)]
        found += [*stream.feed(fourth[:-1])]
        stream.finish()
        assert found == [first, third], length
        # In the middle and at the end; of TRAP the end looks like another beginning.
        assert stream.counts[CUT_SHORT] in (2, 3)
        assert 'at the end' in stream.problem


@pytest.mark.parametrize('make', PACKETS)
def test_a_damaged_packet_is_counted(make):
    first, second, _, _ = PACKETS[make]
    stream = make()
    assert [*stream.feed(first[:-1] + b'\x00' + second)] == [second]
    assert stream.counts[DAMAGED] == 1
    assert stream.problem.startswith('damaged: ')


def test_random_bytes_do_nothing_but_count():
    data = np.random.default_rng(1).bytes(20_000)
    for make in PACKETS:
        stream = make()
        assert not [*stream.feed(data)]
        stream.finish()
        assert stream.counts.total()


def test_udp_sends_one_datagram_each():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.settimeout(HANGS_S)
        link = Link(f'udp://127.0.0.1:{receiver.getsockname()[1]}')
        for packet in PACKETS[space_stream]:
            link.send(packet)
        assert [receiver.recv(1000) for _ in range(4)] == PACKETS[space_stream]
        link.close()


def test_a_serial_line_changes_no_byte():
    own, other = pty.openpty()
    link = Link(os.ttyname(other))
    packet = b'\n\r\x00\x11\x13\x03\xff' + PACKETS[space_stream][0]
    link.send(packet)
    assert os.read(own, 1000) == packet
    link.close()
    os.close(own)
    os.close(other)


@pytest.mark.parametrize(('destination', 'words'), [
    ('', 'neither udp'), ('tcp://127.0.0.1:5', 'neither udp'), ('localhost:5', 'with a slash'),
    ('udp://127.0.0.1', 'must be udp'),
    ('udp://:5', 'must be udp'), ('udp://127.0.0.1:70000', 'udp://127.0.0.1:70000'),
    ('/no/such/folder/tty', '/no/such/folder/tty: No such file')])
def test_a_destination_that_cannot_be_used_is_named(destination, words):
    with pytest.raises(LinkError, match=words):
        Link(destination)


def test_a_capture_is_decoded_and_its_damage_reported(tmp_path):
    first, second, third, fourth = PACKETS[space_stream]
    link = Link(str(tmp_path / 'capture'))
    for packet in (first, second[:40], fourth, third[:10]):
        link.send(packet)
    link.close()
    result = invoke('telemetry', 'decode', str(tmp_path / 'capture'), '--json')
    document = json.loads(result.stdout)
    assert result.exit_code == 0
    assert [row['sequence'] for row in document['rows']] == [0, 3]
    assert document['rows'][1]['q_x'] == 0.1
    conditions = document['conditions']
    assert (conditions['packets'], conditions[CUT_SHORT], conditions[DAMAGED]) == (2, 2, 0)
    assert conditions['packets missing by their sequence'] == 2
    (tmp_path / 'nos3').write_bytes(b''.join(PACKETS[nos3_stream]))
    result = invoke('telemetry', 'decode', str(tmp_path / 'nos3'), '--format', 'nos3', '--json')
    assert [row['valid'] for row in json.loads(result.stdout)['rows']] == [True] * 4


@pytest.mark.parametrize(('numbers', 'missing', 'back'), [
    ((0, 1, 2), 0, 0), ((16382, 16383, 0, 1), 0, 0), ((16382, 2), 3, 0), ((5, 5, 6), 0, 1),
    ((5, 7, 6, 8), 2, 1), ((4000, 0, 1), 0, 1)])
def test_sequence_counts_wrap_repeat_and_begin_anew(tmp_path, numbers, missing, back):
    file = tmp_path / 'capture'
    file.write_bytes(b''.join(space_packet.encode(FrameReport(0, Q), 100, number)
                              for number in numbers))
    conditions = decode_capture(file, 'ccsds', 100).conditions
    assert conditions['packets'] == len(numbers)
    assert conditions['packets missing by their sequence'] == missing
    assert conditions['steps back of the sequence'] == back


def test_packets_of_other_apids_are_named(tmp_path):
    file = tmp_path / 'capture'
    file.write_bytes(b'xy' + b''.join(space_packet.encode(FrameReport(0, Q), apid, 0)
                                      for apid in (42, 100, 42, 7)))
    conditions = decode_capture(file, 'ccsds', 100).conditions
    assert conditions['packets'] == 1
    assert conditions['packets of other apids'] == '1 of 7, 2 of 42'
    assert conditions[SKIPPED] == 2 + 3 * space_packet.LENGTH
    file.write_bytes(b'')
    assert decode_capture(file, 'ccsds', 100).conditions['packets of other apids'] == 'none'
