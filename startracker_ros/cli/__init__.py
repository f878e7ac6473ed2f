"""The command line: parses, calls, prints. Heavy imports wait until a command needs them."""

import click
from startracker_ros import __version__
from startracker_ros.cli.bags import export, info, play, record, report
from startracker_ros.cli.benches import bench
from startracker_ros.cli.campaigns import campaign
from startracker_ros.cli.nodes import demo, doctor, run
from startracker_ros.cli.photographs import calibrate, solve


@click.group(context_settings={'help_option_names': ['-h', '--help']})
@click.version_option(__version__, prog_name='startracker')
def main() -> None:
    """Star images to spacecraft attitude."""


for _command in (run, solve, calibrate, demo, record, play, info, report, export, doctor, campaign,
                 bench):
    main.add_command(_command)
