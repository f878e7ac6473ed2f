# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group bench: speed and accuracy beside peers and bounds."""

from collections.abc import Callable
from pathlib import Path

import click
from startracker_ros.tools.cli.outcome import Commands, exit_1_on, usage_error_on
from startracker_ros.tools.cli.shared import (
    check_names, finish_measured as finish, json_option, scheduler_option, seed_option,
    trials_option)


@click.group(cls=Commands)
def bench() -> None:
    """Measure speed and accuracy beside peers and physical bounds."""


def _bench(function: Callable[..., None]) -> Callable[..., None]:
    function = trials_option(1000, 'Frames of each case.')(function)
    function = click.option('--only', multiple=True, help='Cases to run, by name.')(function)
    return seed_option(json_option(function))


cedar_option = click.option(
    '--cedar-python', type=click.Path(exists=True, dir_okay=False),
    help="Python of a venv with cedar-solve and 'numpy<2', to run that peer as well.")


@bench.command('pipeline')
@_bench
def bench_pipeline(trials: int, seed: int, only: tuple[str, ...], as_json: bool) -> None:
    """Accuracy against the Cramer-Rao bound, identification, start-up, frame times."""
    from startracker_ros.evaluation.bench.pipeline import CASES, run_pipeline_bench
    from startracker_ros.ros.processes import HarnessError
    check_names('case', only, CASES)
    with exit_1_on(HarnessError):
        result = run_pipeline_bench(trials=trials, seed=seed, only=only or tuple(CASES))
    finish(result, as_json)


@bench.command('lost-in-space')
@click.option('--all-cells', is_flag=True, help='Every combination of noise, missing and false.')
@click.option('--camera', 'cameras', multiple=True, help='Cameras to run: A12, B20, C10.')
@cedar_option
@scheduler_option
@_bench
def bench_lost_in_space(all_cells: bool, cameras: tuple[str, ...], cedar_python: str | None,
                        scheduler: str, trials: int, seed: int, only: tuple[str, ...],
                        as_json: bool) -> None:
    """Identification beside tetra3rs and cedar-solve, on the same frames."""
    from startracker_ros.evaluation.bench.corpus import ALL_CELLS, CELLS, VIEWS
    from startracker_ros.evaluation.bench.lost_in_space import DATABASE, run_lost_in_space_bench
    from startracker_ros.evaluation.bench.peers import PeerError
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


@bench.command('identification')
@trials_option(10_000, 'Frames of each camera and model of close pairs.')
@click.option('--only', multiple=True, help='Cases to run, by name.')
@scheduler_option
@seed_option
@json_option
def bench_identification(trials: int, only: tuple[str, ...], scheduler: str, seed: int,
                         as_json: bool) -> None:
    """Frames left unidentified: close pairs resolved, joined or missed, many false spots."""
    from startracker_ros.evaluation.bench.identification import ALL_CASES, run_identification_bench
    check_names('case', only, ALL_CASES)
    finish(run_identification_bench(trials=trials, seed=seed, only=only, scheduler=scheduler),
           as_json)


@bench.command('bag')
@click.option('--inputs', type=click.IntRange(1), default=100_000, show_default=True,
              help='Damaged bags to read.')
@click.option('--only', multiple=True, type=click.Choice(['damage', 'read', 'pace', 'record']),
              help='Parts to run.')
@seed_option
@json_option
def bench_bag(inputs: int, only: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Damaged bags, reading beside the mcap library, pace of a playback, cost of recording."""
    from startracker_ros.evaluation.bench.bag import CASES, run_bag_bench
    finish(run_bag_bench(inputs=inputs, seed=seed, only=only or CASES), as_json)


@bench.command('centroid')
@trials_option(100, 'Images of each signal to noise ratio.')
@click.option('--snr', 'snrs', multiple=True, type=click.FloatRange(1, 1000),
              help='Signal to noise ratios of the stars.  [default: 7, 10, 30, 100, 300]')
@seed_option
@json_option
def bench_centroid(trials: int, snrs: tuple[float, ...], seed: int, as_json: bool) -> None:
    """Time, stars found and error of centroids beside sep, photutils and tetra3rs."""
    from startracker_ros.evaluation.bench.centroid import run_centroid_bench, SNRS
    finish(run_centroid_bench(trials=trials, seed=seed, snrs=snrs or SNRS), as_json)


@bench.command('smear')
@trials_option(20, 'Images of each length and signal to noise ratio.')
@seed_option
@json_option
def bench_smear(trials: int, seed: int, as_json: bool) -> None:
    """Error of the centroids of smeared stars over the Cramer-Rao bound."""
    from startracker_ros.evaluation.bench.smear import run_smear_bench
    finish(run_smear_bench(trials=trials, seed=seed), as_json)


@bench.command('aberration')
@trials_option(1200, 'Images with odometry, and without.')
@seed_option
@json_option
def bench_aberration(trials: int, seed: int, as_json: bool) -> None:
    """Error of attitudes in ICRF over a year of epochs, in all directions and orbits."""
    from startracker_ros.evaluation.bench.aberration import run_aberration_bench
    finish(run_aberration_bench(trials=trials, seed=seed), as_json)


@bench.command('jpda')
@trials_option(5, 'Runs of each scene.')
@click.option('--scene', 'scenes', multiple=True,
              type=click.Choice(['apart', 'crossing', 'close']), help='Scenes to run.')
@click.option('--tracks', multiple=True, type=click.IntRange(2, 500),
              help='Numbers of tracks.  [default: 4, 10, 20, 40, 100, 200]')
@seed_option
@json_option
def bench_jpda(trials: int, scenes: tuple[str, ...], tracks: tuple[int, ...], seed: int,
               as_json: bool) -> None:
    """Time, error and swapped tracks of the JPDA filter beside Stone Soup."""
    from startracker_ros.evaluation.bench.jpda import run_jpda_bench, TRACKS
    from startracker_ros.evaluation.bench.moving_targets import SCENES
    finish(run_jpda_bench(trials=trials, seed=seed, scenes=scenes or SCENES,
                          tracks=tracks or TRACKS), as_json)


@bench.command('attitude')
@trials_option(2000, 'Draws of each number of vectors.')
@click.option('--vectors', multiple=True, type=click.IntRange(2, 1000),
              help='Numbers of vectors.  [default: 4, 20, 40]')
@seed_option
@json_option
def bench_attitude(trials: int, vectors: tuple[int, ...], seed: int, as_json: bool) -> None:
    """Time, error and covariance of the attitude solvers beside SciPy's align_vectors."""
    from startracker_ros.evaluation.bench.attitude import run_attitude_bench, VECTORS
    finish(run_attitude_bench(trials=trials, seed=seed, vectors=vectors or VECTORS), as_json)


@bench.command('real-sky')
@click.argument('folders', nargs=-1,
                type=click.Path(exists=True, file_okay=False, path_type=Path))
@cedar_option
@seed_option
@json_option
def bench_real_sky(folders: tuple[Path, ...], cedar_python: str | None, seed: int,
                   as_json: bool) -> None:
    """Photographs in FOLDERS with a solutions.csv beside them, ours beside peers."""
    from startracker_ros.evaluation.bench.peers import PeerError
    from startracker_ros.evaluation.bench.photographs import FolderError
    from startracker_ros.evaluation.bench.real_sky import run_real_sky_bench
    with usage_error_on(FolderError), exit_1_on(PeerError):
        result = run_real_sky_bench(folders, seed=seed, cedar_python=cedar_python or '')
    finish(result, as_json)


@bench.command('reprocess')
@trials_option(6000, 'Frames of the recording.', least=1200)
@click.option('--only', multiple=True, help='Cases to run, by name.')
@seed_option
@json_option
def bench_reprocess(trials: int, seed: int, only: tuple[str, ...], as_json: bool) -> None:
    """Frames a second of reprocessing, reading beside a plain read, one and two workers."""
    from startracker_ros.evaluation.bench.reprocess import CASES, run_reprocess_bench
    check_names('case', only, CASES)
    finish(run_reprocess_bench(trials=trials, seed=seed, only=only or CASES), as_json)


@bench.command('tracklets')
@trials_option(7200, 'Frames of the recording.', least=600)
@seed_option
@json_option
def bench_tracklets(trials: int, seed: int, as_json: bool) -> None:
    """Find moving objects in simulated flights, among false centroids and hot pixels."""
    from startracker_ros.evaluation.bench.tracklets import run_tracklet_bench
    finish(run_tracklet_bench(trials=trials, seed=seed), as_json)


@bench.command('trend')
@trials_option(200, 'Flights with a step of each kind.', least=10)
@click.option('--only', multiple=True, help='Cases to run, by name.')
@seed_option
@json_option
def bench_trend(trials: int, seed: int, only: tuple[str, ...], as_json: bool) -> None:
    """Search long flights for injected steps of mounts and focal lengths, and clean months."""
    from startracker_ros.evaluation.bench.trend import CASES, run_trend_bench
    check_names('case', only, CASES)
    finish(run_trend_bench(trials=trials, seed=seed, only=only or CASES), as_json)


@bench.command('smoothing')
@_bench
def bench_smoothing(trials: int, seed: int, only: tuple[str, ...], as_json: bool) -> None:
    """Error of smoothed attitudes over that of the star tracker, and their NEES."""
    from startracker_ros.evaluation.bench.smoothing import CASES, run_smoothing_bench
    check_names('case', only, CASES)
    finish(run_smoothing_bench(trials=trials, seed=seed, only=only or tuple(CASES)), as_json)
