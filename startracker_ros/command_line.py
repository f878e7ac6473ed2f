# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group of all commands."""

import click
from startracker_ros import __version__
from startracker_ros.tools.cli.bags import export, info, play, record, report
from startracker_ros.tools.cli.flights import compare, reprocess, simulate, tracklets, trend
from startracker_ros.tools.cli.instruments import datasheet, design, sky
from startracker_ros.tools.cli.nodes import demo, doctor, live, run
from startracker_ros.tools.cli.outcome import Main
from startracker_ros.tools.cli.photographs import calibrate, catalogue, night, solve
from startracker_ros.tools.cli.telemetry import telemetry


@click.group(cls=Main, joined='startracker.commands', elsewhere=('bench', 'campaign'),
             context_settings={'help_option_names': ['-h', '--help']})
@click.version_option(__version__, prog_name='startracker')
def main() -> None:
    """Star images to spacecraft attitude."""


main.add_section('Photographs', solve, calibrate, catalogue, night)
main.add_section('Pipeline', demo, live, run, sky, telemetry)
main.add_section('Bags', record, play, info, report, export, simulate, reprocess, compare, trend,
                 tracklets)
main.add_section('Evaluation', datasheet, design, elsewhere=('bench', 'campaign'))
main.add_section('Help', doctor)
