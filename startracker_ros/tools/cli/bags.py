# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands about bags: record, play, info, report, export."""

from pathlib import Path
import sys
from typing import TYPE_CHECKING

import click
from startracker_ros.tools.cli.outcome import (
    exit_1_on, FAILED, FailedError, InputPath, usage_error_on)
from startracker_ros.tools.cli.shared import (
    become_node, json_option, namespace_option, output_option, print_result)

if TYPE_CHECKING:
    from startracker_ros.io.table import Result


@click.command()
@click.argument('topics', nargs=-1, metavar='[TOPIC]...')
@click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False),
              help='New folder of the bag.  [default: startracker_<date>_<time>]')
@click.option('--exclude', multiple=True, metavar='PATTERN',
              help='Topics left out.  [default: */image_annotated, */transition_event]')
@click.option('--compression', type=click.Choice(['none', 'lz4', 'zstd']), default='zstd',
              show_default=True, help='Of the chunks of the bag.')
@click.option('--max-file-size-mb', type=click.FloatRange(0), default=0.0,
              help='Begin a new file of the bag when one is larger.')
@click.option('--max-file-duration-s', type=click.FloatRange(0), default=0.0,
              help='Begin a new file of the bag when one spans more.')
def record(topics: tuple[str, ...], output: Path | None, exclude: tuple[str, ...],
           compression: str, max_file_size_mb: float, max_file_duration_s: float) -> None:
    """Record TOPICs (patterns with *, all by default) into an MCAP bag, until Ctrl-C."""
    from startracker_ros.io.output import output_folder
    from startracker_ros.ros.processes import parameter_arguments
    parameters = {'compression': compression, 'max_file_size_mb': max_file_size_mb,
                  'max_file_duration_s': max_file_duration_s}
    if output is not None:
        output_folder(output.absolute().parent)
        if output.is_dir() and any(output.iterdir()):
            raise FailedError(f'{output}: the folder is not empty')
        parameters['folder'] = str(output)
    if topics:
        parameters['topics'] = topics
    if exclude:
        parameters['exclude'] = exclude
    become_node('bag_recorder', parameter_arguments(parameters))


@click.command()
@click.argument('bag', type=InputPath())
@click.option('--topic', 'topics', multiple=True, metavar='PATTERN',
              help='Topics to play, * for any characters.  [default: all]')
@click.option('--exclude', multiple=True, metavar='PATTERN',
              help='Topics left out.  [default: /parameter_events, /rosout, '
              '*/transition_event]')
@click.option('--remap', 'remaps', multiple=True, metavar='FROM:=TO', help='Rename a topic.')
@click.option('--rate', type=click.FloatRange(0.01, 1000), default=1.0, show_default=True,
              help='Times as fast as recorded.')
@click.option('--start-offset-s', type=click.FloatRange(0), default=0.0,
              help='Recorded time left out at the beginning.')
@click.option('--latched', is_flag=True,
              help='Publish first what latched topics held at the offset.')
@click.option('--duration-s', type=click.FloatRange(0), default=0.0,
              help='Recorded time that is played.')
@click.option('--loop', is_flag=True, help='Begin again after the end.')
@click.option('--start-paused', is_flag=True,
              help='Wait for the service /bag_player/resume or /bag_player/step.')
@click.option('--clock-rate-hz', type=click.FloatRange(0, 1000), default=100.0,
              show_default=True, help='/clock messages a second, 0 for none.')
def play(bag: Path, topics: tuple[str, ...], exclude: tuple[str, ...], remaps: tuple[str, ...],
         **options: float | bool) -> None:
    """Publish the messages of a BAG (folder or .mcap file) at the pace of the recording."""
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.io.bags.reader import read_topics
    from startracker_ros.ros.processes import parameter_arguments
    with exit_1_on(BagError):
        # Here for one line and its status; the node reports it among others in its log.
        read_topics(bag, tolerant=True)
    parameters: dict[str, object] = {'path': str(bag), **options}
    if topics:
        parameters['topics'] = topics
    if exclude:
        parameters['exclude'] = exclude
    renamed = [word for remap in remaps for word in ('-r', remap)]
    become_node('bag_player', [*parameter_arguments(parameters), *renamed])


@click.command()
@click.argument('bag', type=InputPath())
@click.option('--recover', 'output', metavar='OUT', type=click.Path(path_type=Path),
              help='Write all that is whole of an unfinished or damaged bag into a new one.')
@json_option
def info(bag: Path, output: Path | None, as_json: bool) -> None:
    """List what a BAG (folder or .mcap file) holds; status 1 when it is not whole."""
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.io.bags.info import describe
    from startracker_ros.io.bags.recovery import recover
    with exit_1_on(BagError):
        if output is not None:
            recover(bag, output, report=lambda problem: click.echo(problem, err=True))
            bag = output
        result, problems = describe(bag)
    print_result(result, as_json)
    for problem in problems:
        click.echo(f'startracker: {problem}', err=True)
    if problems:
        sys.exit(1)


@click.command()
@click.argument('bag', type=InputPath())
@output_option('report.html', 'Page to write.', folder=False)
@namespace_option
@json_option
def report(bag: Path, output: Path, namespace: str | None, as_json: bool) -> None:
    """Write one HTML page of a BAG: attitude, errors, stars, states, times, frames."""
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.tools.report.page import write_report
    with exit_1_on(BagError, output=output):
        result = write_report(bag, output, namespace)
    print_result(result, as_json)
    frames = {row['case']: row['value'] for row in result.rows}['frames']
    _fail_without(frames, bag, result)


@click.command()
@click.argument('bag', type=InputPath())
@output_option('export', 'Folder for the files.')
@click.option('--format', 'formats', multiple=True, default=('aem', 'csv'), show_default=True,
              type=click.Choice(['aem', 'csv', 'parquet']), help='One or more of them.')
@click.option('--originator', default='UNKNOWN', show_default=True, help='Of the AEM.')
@click.option('--object-name', default='UNKNOWN', show_default=True, help='In the AEM.')
@click.option('--object-id', default='UNKNOWN', show_default=True,
              help='In the AEM: the international designator.')
@namespace_option
@json_option
def export(bag: Path, output: Path, formats: tuple[str, ...], originator: str, object_name: str,
           object_id: str, namespace: str | None, as_json: bool) -> None:
    """Write attitude, tracks and diagnostics of a BAG as CCSDS AEM, CSV or Parquet."""
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.io.export.aem import AemError, AemLabels
    from startracker_ros.io.export.files import export_bag
    with usage_error_on(AemError):
        labels = AemLabels(originator, object_name, object_id)
    with exit_1_on(BagError, AemError, output=output):
        result = export_bag(bag, output, formats, labels, namespace)
    print_result(result, as_json)
    _fail_without(sum(row['rows'] for row in result.rows), bag, result)


def _fail_without(rows: int, bag: Path, result: 'Result') -> None:
    """End with status 1, and with what is wrong with a bag, where nothing came out of it."""
    if not rows:
        reasons = [reason for key in ('problem', 'without rows')
                   for name, reason in result.conditions.items() if name.startswith(key)]
        click.echo(f'startracker: nothing in {bag}: {reasons[0]}', err=True)
        sys.exit(FAILED)
