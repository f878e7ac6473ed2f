# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group telemetry: packets out of a capture, and their description."""

from pathlib import Path

import click
from startracker_ros.tools.cli.outcome import Commands, exit_1_on, FailedError, InputPath
from startracker_ros.tools.cli.shared import finish, json_option

_apid_option = click.option('--apid', type=click.IntRange(0, 2046), default=100,
                            show_default=True, metavar='N', help='Of the space packets.')


@click.group(cls=Commands)
def telemetry() -> None:
    """Decode packets of telemetry_bridge; describe them in XTCE."""


@telemetry.command('decode')
@click.argument('capture', type=InputPath(dir_okay=False))
@click.option('--format', 'packet_format', type=click.Choice(['ccsds', 'nos3']), default='ccsds',
              show_default=True, help='Kind of the packets.')
@_apid_option
@json_option
def telemetry_decode(capture: Path, packet_format: str, apid: int, as_json: bool) -> None:
    """Decode the packets of a file; what is cut short or damaged is counted."""
    from startracker_ros.io.telemetry.capture import decode_capture
    with exit_1_on(output=capture):
        result = decode_capture(capture, packet_format, apid)
        if not result.rows:
            counts = ', '.join(f'{name}: {value}' for name, value in result.conditions.items())
            raise FailedError(f'{capture}: not one packet; {counts}')
    finish(result, as_json)


@telemetry.command('xtce')
@_apid_option
def telemetry_xtce(apid: int) -> None:
    """Print the XTCE description of the space packets."""
    from startracker_ros.io.telemetry.xtce import xtce_text
    click.echo(xtce_text(apid), nl=False)
