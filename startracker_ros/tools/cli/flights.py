# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands about long flights: simulate, reprocess, compare, trend, tracklets."""

from pathlib import Path
import sys

import click
from startracker_ros.tools.cli.outcome import (
    exit_1_on, FAILED, InputName, InputPath, usage_error_on)
from startracker_ros.tools.cli.shared import (
    json_option, output_option, print_result, scheduler_option, seed_option)

_FILES = 'Folder for the files.'

workers_option = click.option('--workers', type=click.IntRange(1, 256), default=None, metavar='N',
                              help='Processes of this machine.  [default: one for each core]')


def _workers(workers: int | None) -> int:
    from startracker_ros.io.workers import default_workers
    return workers or default_workers()


@click.command()
@output_option('flight', _FILES)
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='Options of the flight, listed by --options.')
@click.option('--options', 'listed', is_flag=True, help='List the options, and end.')
@workers_option
@scheduler_option
@seed_option
@json_option
def simulate(output: Path, settings: tuple[str, ...], listed: bool, workers: int | None,
             scheduler: str, seed: int, as_json: bool) -> None:
    """
    Write bags of a long flight of two heads, with drifts and truth.

    They hold centroids and telemetry.
    """
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.io.table import Result
    from startracker_ros.sim.flights.bags import simulate_flight
    from startracker_ros.sim.flights.options import flight_options, FlightOptions
    if listed:
        print_result(Result('options of a flight', [
            {'option': row.name, 'default': row.default, 'unit': row.unit,
             'range': row.range_text, 'meaning': row.description}
            for row in FlightOptions.table()]), as_json)
        return
    with usage_error_on(ValueError):
        options = flight_options(settings)
    with exit_1_on(BagError, output=output):
        result = simulate_flight(output, options, seed, workers=_workers(workers),
                                 scheduler=scheduler)
    print_result(result, as_json)


@click.command()
@click.argument('bags', nargs=-1, required=True, metavar='BAG...', type=InputName())
@output_option('reprocessed', _FILES)
@click.option('--source', type=click.Choice(['centroids', 'image_raw']), default=None,
              help='What is processed.  [default: centroids where a bag has them]')
@click.option('--parameters', 'files', multiple=True,
              type=InputPath(dir_okay=False), metavar='FILE',
              help='YAML files of node parameters.')
@click.option('--set', 'settings', multiple=True, metavar='NODE.NAME=A[,B...]',
              help='A parameter, or several values: a run with each combination.')
@click.option('--segment-s', type=click.FloatRange(1, 86400), default=3600.0, show_default=True,
              metavar='SECONDS',
              help='Recordings are cut into segments of this length; each begins lost.')
@click.option('--overlap-s', type=click.FloatRange(0, 3600), default=60.0, show_default=True,
              metavar='SECONDS',
              help='Time before a segment from which its pipeline runs.')
@click.option('--bag-topic', 'patterns', multiple=True, default=('*',), show_default=True,
              metavar='PATTERN', help='Topics of the bags that are written.')
@click.option('--no-bags', is_flag=True, help='Write tables only.')
@click.option('--smooth', is_flag=True,
              help='Add a table of smoothed attitudes, rates and gyro biases.')
@workers_option
@scheduler_option
@json_option
def reprocess(bags: tuple[str, ...], output: Path, source: str | None, files: tuple[Path, ...],
              settings: tuple[str, ...], segment_s: float, overlap_s: float,
              patterns: tuple[str, ...], no_bags: bool, smooth: bool, workers: int | None,
              scheduler: str, as_json: bool) -> None:
    """
    Run the pipeline over recorded BAGs again.

    BAGs are folders, patterns, or text files that list them. Writes bags as the nodes do,
    Parquet tables by day and tracker, summary and error table. A command that is repeated
    continues where the one before ended.
    """
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.tools.reprocess.output import chosen_topics
    from startracker_ros.tools.reprocess.parameters import parameter_sets
    from startracker_ros.tools.reprocess.plan import SegmentOptions
    from startracker_ros.tools.reprocess.run import ERRORS, NOTHING, reprocess as run, Request
    with usage_error_on(ValueError):
        sets, unused = parameter_sets(files, settings)
        segments = SegmentOptions(segment_s=segment_s, overlap_s=overlap_s)
    topics = frozenset() if no_bags else chosen_topics(patterns)
    if not (no_bags or topics):
        raise click.UsageError(f'--bag-topic {" ".join(patterns)} matches no topic')
    for name in unused:
        click.echo(f'startracker: {name} has no effect here', err=True)
    with exit_1_on(BagError, output=output):
        result = run(Request(bags, output, source or '', segments, topics, smooth, sets),
                     workers=_workers(workers), scheduler=scheduler)
    print_result(result, as_json)
    failed = result.conditions['not_processed']
    if failed != NOTHING or not result.conditions['frames']:
        what = (f'not processed: {failed}' if failed != NOTHING else
                f'no frame was processed: {result.conditions["first_error"]}')
        click.echo(f'startracker: {output}: {what}; see {ERRORS}', err=True)
        sys.exit(FAILED)


@click.command()
@click.argument('out_a', type=InputPath())
@click.argument('out_b', type=InputPath())
@click.option('--picture', type=click.Path(path_type=Path, dir_okay=False),
              help='Draw the differences into this PNG file.')
@json_option
def compare(out_a: Path, out_b: Path, picture: Path | None, as_json: bool) -> None:
    """
    Compare two runs of reprocess.

    Attitudes, availability, first divergent frame.
    """
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.tools.reprocess.compare import compare as compare_runs
    with exit_1_on(BagError, output=picture):
        result = compare_runs(out_a, out_b, picture)
    print_result(result, as_json)


@click.command()
@click.argument('out', type=InputPath())
@output_option('trend.html', 'Page to write.', folder=False)
@click.option('--orbit-s', type=click.FloatRange(60), default=5801.0, show_default=True,
              metavar='SECONDS',
              help='Period of what changes with the heat of each orbit.')
@json_option
def trend(out: Path, output: Path, orbit_s: float, as_json: bool) -> None:
    """
    Find drifts and steps in a run of reprocess.

    Of focal length, mounts, zero point and single stars.
    """
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.tools.trend.trend import trend as find_trend
    with exit_1_on(BagError, output=output):
        result = find_trend(out, output, orbit_s)
    print_result(result, as_json)


@click.command()
@click.argument('out', type=InputPath())
@output_option('tracklets', _FILES)
@click.option('--originator', default='UNKNOWN', show_default=True, metavar='NAME',
              help='Who makes the messages, for their header.')
@json_option
def tracklets(out: Path, output: Path, originator: str, as_json: bool) -> None:
    """List moving objects in a run of reprocess; write CCSDS TDM."""
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.tools.reprocess.tracklets import tracklets as find_tracklets
    with exit_1_on(BagError, output=output):
        result = find_tracklets(out, output, originator)
    print_result(result, as_json)
