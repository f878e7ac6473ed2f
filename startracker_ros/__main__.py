"""The command line: `startracker`, and `python -m startracker_ros`."""

from typing import Any

import click
from startracker_ros import __version__
from startracker_ros.core.extras import MissingLibraryError, with_ros
from startracker_ros.evaluation.cli.benches import bench
from startracker_ros.evaluation.cli.campaigns import campaign
from startracker_ros.evaluation.cli.closed_loop import demo_closed_loop
from startracker_ros.evaluation.cli.instruments import datasheet, design
from startracker_ros.tools.cli.bags import export, info, play, record, report
from startracker_ros.tools.cli.flights import compare, reprocess, simulate, tracklets, trend
from startracker_ros.tools.cli.nodes import demo, doctor, live, run
from startracker_ros.tools.cli.photographs import calibrate, solve
from startracker_ros.tools.cli.shared import exit_1_on
from startracker_ros.tools.cli.telemetry import telemetry


class _Main(click.Group):
    """Ends every command with status 1 and one line where a library that it needs is missing."""

    def invoke(self, context: click.Context) -> Any:
        with exit_1_on(MissingLibraryError), with_ros():
            return super().invoke(context)


@click.group(cls=_Main, context_settings={'help_option_names': ['-h', '--help']})
@click.version_option(__version__, prog_name='startracker')
def main() -> None:
    """Star images to spacecraft attitude."""


for _command in (run, live, solve, calibrate, demo, record, play, info, report, export, doctor,
                 campaign, bench, datasheet, design, telemetry, simulate, reprocess, compare,
                 trend, tracklets):
    main.add_command(_command)
demo.add_command(demo_closed_loop)

if __name__ == '__main__':
    main()
