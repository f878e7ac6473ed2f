# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group bench: speed and accuracy compared with peers and bounds."""

from functools import partial
from pathlib import Path

import click
from startracker_evaluation.cli.measurement import HARNESS, measurement, only_option
from startracker_ros.tools.cli.outcome import Commands, exit_1_on, InputPath, usage_error_on
from startracker_ros.tools.cli.shared import (
    check_names, finish_measured as finish, json_option, scheduler_option, seed_option,
    trials_option)


@click.group(cls=Commands)
def bench() -> None:
    """Measure speed and accuracy against peers and physical bounds."""


_bench = partial(measurement, bench)
_cedar_option = click.option(
    '--cedar-python', type=InputPath(dir_okay=False),
    help="Python of a venv with cedar-solve and 'numpy<2', to run that peer as well.")

_bench('pipeline', 'bench.pipeline:run_pipeline_bench',
       'Accuracy against the Cramer-Rao bound, identification, start-up, frame times.',
       trials_option(1000, 'Frames of each case.'), only_option('Cases'), known='CASES',
       error=HARNESS)


@bench.command('lost-in-space')
@click.option('--all-cells', is_flag=True, help='Every combination of noise, missing and false.')
@click.option('--camera', 'cameras', multiple=True, metavar='NAME',
              help='Cameras to run: A12, B20, C10.')
@_cedar_option
@trials_option(1000, 'Frames of each case.')
@only_option('Cases')
@scheduler_option
@seed_option
@json_option
def bench_lost_in_space(all_cells: bool, cameras: tuple[str, ...], cedar_python: str | None,
                        scheduler: str, trials: int, seed: int, only: tuple[str, ...],
                        as_json: bool) -> None:
    """Identification compared with tetra3rs and cedar-solve, on the same frames."""
    from startracker_evaluation.bench.corpus import ALL_CELLS, CELLS, VIEWS
    from startracker_evaluation.bench.lost_in_space import DATABASE, run_lost_in_space_bench
    from startracker_evaluation.bench.peers import PeerError
    for kind, named, known in (('case', only, (DATABASE, *ALL_CELLS)), ('camera', cameras, VIEWS)):
        check_names(kind, named, known)
    if cedar_python and scheduler:
        raise click.UsageError('cedar-solve runs on this machine, without --scheduler')
    chosen = only or (DATABASE, *(ALL_CELLS if all_cells else CELLS))
    with exit_1_on(PeerError):
        result = run_lost_in_space_bench(
            trials=trials, seed=seed, only=chosen, cameras=cameras or tuple(VIEWS),
            cedar_python=cedar_python or '', scheduler=scheduler)
    finish(result, as_json)


@bench.command('real-sky')
@click.argument('folders', nargs=-1,
                type=InputPath(file_okay=False))
@_cedar_option
@seed_option
@json_option
def bench_real_sky(folders: tuple[Path, ...], cedar_python: str | None, seed: int,
                   as_json: bool) -> None:
    """Photographs in FOLDERS with a solutions.csv, ours compared with peers."""
    from startracker_evaluation.bench.peers import PeerError
    from startracker_evaluation.bench.real_sky import FolderError, run_real_sky_bench
    with usage_error_on(FolderError), exit_1_on(PeerError):
        result = run_real_sky_bench(folders, seed=seed, cedar_python=str(cedar_python or ''))
    finish(result, as_json)


_bench('identification', 'bench.identification:run_identification_bench',
       'Frames left unidentified: close pairs resolved, joined or missed, many false detections.',
       trials_option(10_000, 'Frames of each camera and model of close pairs.'),
       only_option('Cases'), scheduler_option, known='ALL_CASES')
_bench('own-catalogue', 'bench.own_catalogue:run_own_catalogue_bench',
       'Narrow fields with a deep catalogue of the user, near a position and anywhere.',
       trials_option(100, 'Images of each case and search.'), only_option('Cases'),
       click.option('--stars', type=click.IntRange(100_000), default=15_000_000,
                    show_default=True, metavar='N', help='Stars of the simulated sky.'),
       click.option('--folder', type=click.Path(path_type=Path), metavar='FOLDER',
                    help='Where the catalogue is kept for other runs.'), known='CASES')
_bench('bag', 'bench.bag:run_bag_bench',
       'Damaged bags, reading by the mcap library too, pace of a playback, cost of recording.',
       click.option('--inputs', type=click.IntRange(1), default=100_000, show_default=True,
                    metavar='N', help='Damaged bags to read.'),
       click.option('--only', multiple=True,
                    type=click.Choice(['damage', 'read', 'pace', 'record']),
                    help='Parts to run.'))
_bench('centroid', 'bench.centroid:run_centroid_bench',
       'Time, stars found and error of centroids compared with sep, photutils and tetra3rs.',
       trials_option(100, 'Images of each signal to noise ratio.'),
       click.option('--snr', 'snrs', multiple=True, type=click.FloatRange(1, 1000), metavar='SNR',
                    help='Signal to noise ratios of the stars.  [default: 7, 10, 30, 100, 300]'))
_bench('smear', 'bench.smear:run_smear_bench',
       'Error of the centroids of smeared stars over the Cramer-Rao bound.',
       trials_option(20, 'Images of each length and signal to noise ratio.'))
_bench('aberration', 'bench.aberration:run_aberration_bench',
       'Error of attitudes in ICRF over a year of epochs, in all directions and orbits.',
       trials_option(1200, 'Images with odometry, and without.'))
_bench('jpda', 'bench.jpda:run_jpda_bench',
       'Time, error and swapped tracks of the JPDA filter compared with Stone Soup.',
       trials_option(5, 'Runs of each scene.'),
       click.option('--scene', 'scenes', multiple=True,
                    type=click.Choice(['apart', 'crossing', 'close']), help='Scenes to run.'),
       click.option('--tracks', multiple=True, type=click.IntRange(2, 500), metavar='N',
                    help='Numbers of tracks.  [default: 4, 10, 20, 40, 100, 200]'))
_bench('attitude', 'bench.attitude:run_attitude_bench',
       "Time, error and covariance of the attitude solvers compared with SciPy's align_vectors.",
       trials_option(2000, 'Draws of each number of vectors.'),
       click.option('--vectors', multiple=True, type=click.IntRange(2, 1000), metavar='N',
                    help='Numbers of vectors.  [default: 4, 20, 40]'))
_bench('reprocess', 'bench.reprocess:run_reprocess_bench',
       'Frames a second of reprocessing, reading compared with a plain read, one and two workers.',
       trials_option(6000, 'Frames of the recording.', least=1200), only_option('Cases'),
       known='CASES')
_bench('constellation', 'bench.constellation:run_constellation_bench',
       'A year of 1000 heads: load of a dask scheduler, of an object store and of processors.',
       trials_option(1_000_000, 'Empty tasks that the scheduler gets.'), only_option('Cases'),
       known='CASES')
_bench('flight', 'bench.flight:run_flight_bench',
       'Memory, code, stack, worst frame and instructions of the native core, in a source tree.',
       trials_option(300, 'Frames of the recording.'), only_option('Cases'), known='CASES')
_bench('tracklets', 'bench.tracklets:run_tracklet_bench',
       'Find moving objects in simulated flights, among false centroids and hot pixels.',
       trials_option(7200, 'Frames of the recording.', least=600))
_bench('trend', 'bench.trend:run_trend_bench',
       'Search long flights for injected steps of mounts and focal lengths, and clean months.',
       trials_option(200, 'Flights with a step of each kind.', least=10), only_option('Cases'),
       known='CASES')
_bench('smoothing', 'bench.smoothing:run_smoothing_bench',
       'Error of smoothed attitudes over that of the star tracker, and their NEES.',
       trials_option(1000, 'Frames of each case.'), only_option('Cases'), known='CASES')
