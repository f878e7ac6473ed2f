# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports to packets of the kind that a user selects."""

from dataclasses import dataclass

from startracker_ros.core.options import option, Options
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.report import FrameReport


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
