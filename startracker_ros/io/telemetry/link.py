# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports as packets, and where they are sent: UDP, a serial device, or a file."""

from dataclasses import dataclass
import os
from pathlib import Path
import socket
import stat
import tty
from urllib.parse import urlsplit

from startracker_ros.core.options import option, Options
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.report import FrameReport


class LinkError(ValueError):
    """A destination that cannot be used; the text names it."""


class Link:
    """Sends packets to udp://HOST:PORT or to a path with a slash: a serial device or a file."""

    def __init__(self, destination: str) -> None:
        self._socket: socket.socket | None = None
        self._file = -1
        if destination.startswith('udp://'):
            self._address = _udp_address(destination)
            family = socket.AF_INET6 if ':' in self._address[0] else socket.AF_INET
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        elif '/' in destination and '://' not in destination:
            self._open(Path(destination))
        else:
            # localhost:10035 is not a file to be made.
            raise LinkError(f'destination {destination!r} is neither udp://HOST:PORT nor a path '
                            'with a slash, as ./packets.bin')

    def send(self, packet: bytes) -> None:
        """Send a packet without waiting; OSError if it does not go out whole."""
        if self._socket is not None:
            self._socket.sendto(packet, self._address)
            return
        sent = os.write(self._file, packet)
        if sent != len(packet):
            raise OSError(f'{sent} of {len(packet)} bytes sent, the rest is lost: '
                          'the line is too slow')

    def close(self) -> None:
        """Close socket or file."""
        if self._socket is not None:
            self._socket.close()
        elif self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _open(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOCTTY | os.O_NONBLOCK
        try:
            self._file = os.open(path, flags, 0o644)
        except OSError as error:
            raise LinkError(f'destination {path}: {error.strerror}') from error
        if stat.S_ISCHR(os.fstat(self._file).st_mode) and os.isatty(self._file):
            # Else the terminal would send a carriage return with each byte 0x0A.
            tty.setraw(self._file)


def _udp_address(destination: str) -> tuple[str, int]:
    try:
        parts = urlsplit(destination)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise LinkError(f'destination {destination!r}: {error}') from error
    if not host or not port or parts.path:
        raise LinkError(f'destination {destination!r} must be udp://HOST:PORT')
    try:
        return str(socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][4][0]), port
    except OSError as error:
        raise LinkError(f'destination {destination!r}: {error.strerror}') from error


# --- reports as packets ---

@dataclass(frozen=True)
class TelemetryOptions(Options):
    """Where telemetry goes, and as which packets."""

    destination: str = option(
        'udp://127.0.0.1:10035', 'where packets go: udp://HOST:PORT, or the path, with a slash, '
        'of a serial device, whose speed stty sets, or of a file to append to')
    packet_format: str = option(
        'ccsds', 'ccsds: space packets; nos3: replies of the generic star tracker of NOS3',
        choices=('ccsds', 'nos3'))
    apid: int = option(100, 'application process identifier of the space packets', low=0,
                       high=2046)


class Encoder:
    """Encodes reports and numbers the packets; MissingLibraryError without spacepackets."""

    def __init__(self, options: TelemetryOptions) -> None:
        self._options = options
        self._sequence = 0
        if options.packet_format == 'ccsds':
            space_packet.sync(options.apid)

    def encode(self, report: FrameReport) -> bytes:
        """Return the packet of a report; TelemetryError where it does not fit."""
        if self._options.packet_format == 'nos3':
            return nos3.encode(report)
        packet = space_packet.encode(report, self._options.apid, self._sequence)
        self._sequence += 1
        return packet
