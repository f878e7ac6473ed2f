"""The command line: parses, calls, prints. Heavy imports wait until a command needs them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import sys
from typing import TYPE_CHECKING

import click
from startracker_ros import __version__

if TYPE_CHECKING:
    from startracker_ros.table import Result

_json = click.option('--json', 'as_json', is_flag=True, help='Print one JSON document.')

_scheduler = click.option('--scheduler', default='', metavar='ADDRESS',
                          help='Dask cluster to use instead of the cores of this machine.')
_namespace = click.option('--namespace', metavar='NAME',
                          help='Of the star tracker.  [default: the only one in the bag]')
_seed = click.option('--seed', type=click.IntRange(0), default=1, show_default=True)


def _finish(result: 'Result', as_json: bool) -> None:
    """Print a result; status 1 when a row does not hold."""
    from startracker_ros.table import show
    show(result, as_json)
    if not all(row.get('holds', True) for row in result.rows):
        sys.exit(1)


def _fail(message: str) -> None:
    """End with status 1: the work failed."""
    click.echo(f'startracker: {message}', err=True)
    sys.exit(1)


@contextmanager
def _told(*errors: type[Exception], output: Path | None = None) -> Iterator[None]:
    """End with status 1 on these errors, and on those of the system where output is written."""
    try:
        yield
    except errors as error:
        _fail(str(error))
    except OSError as error:
        if output is None:
            raise
        _fail(f'{output}: {error.strerror}')


def _check_names(kind: str, named: Iterable[str], known: Iterable[str]) -> None:
    unknown = set(named) - set(known)
    if unknown:
        raise click.UsageError(f'no {kind} {", ".join(sorted(unknown))}; there are '
                               f'{", ".join(known)}')


@click.group(context_settings={'help_option_names': ['-h', '--help']})
@click.version_option(__version__, prog_name='startracker')
def main() -> None:
    """Star images to spacecraft attitude."""


@main.command(context_settings={'ignore_unknown_options': True, 'help_option_names': []})
@click.argument('node')
@click.argument('arguments', nargs=-1, type=click.UNPROCESSED)
def run(node: str, arguments: tuple[str, ...]) -> None:
    """Run one NODE, as `ros2 run startracker_ros NODE` does; takes --ros-args."""
    from startracker_ros.executables import EXECUTABLES
    from startracker_ros.ros.processes import node_command, node_environment
    if node not in EXECUTABLES:
        raise click.UsageError(f'no node {node!r}; there are {", ".join(EXECUTABLES)}')
    command = node_command(node, arguments)
    os.execve(command[0], command, node_environment())


@main.command()
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('--fov-deg', type=float, help='Horizontal field of view, edge to edge.')
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML as camera_calibration writes it, instead of --fov-deg.')
@click.option('--fov-error-percent', type=click.FloatRange(0, 5), default=0.5,
              show_default=True, help='How far the field of view may be off.')
@click.option('--epoch', 'epoch_year', type=float,
              help='Julian year of the images, for proper motion.  [default: today]')
@click.option('--annotate', 'annotate_folder', type=click.Path(path_type=Path),
              help='Folder for a PNG of each image with the identified stars.')
@_json
def solve(images: tuple[Path, ...], fov_deg: float | None, camera_file: Path | None,
          fov_error_percent: float, epoch_year: float | None, annotate_folder: Path | None,
          as_json: bool) -> None:
    """Attitude of star IMAGES: right ascension, declination, roll, stars, residual."""
    from startracker_ros.camera import CameraError
    from startracker_ros.identify.identification import IdentificationOptions
    from startracker_ros.solve import solve_files
    from startracker_ros.table import show
    if (fov_deg is None) == (camera_file is None):
        raise click.UsageError('give either --fov-deg or --camera')
    try:
        result = solve_files(images, fov_deg=fov_deg, camera_file=camera_file,
                             epoch_year=epoch_year, annotate_folder=annotate_folder,
                             options=IdentificationOptions(fov_error_percent=fov_error_percent))
    except CameraError as error:
        raise click.UsageError(str(error)) from error
    show(result, as_json)
    if not all(row['solved'] for row in result.rows):
        sys.exit(1)


@main.command()
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('-o', '--output', required=True, type=click.Path(path_type=Path, dir_okay=False),
              help='Camera YAML to write, as camera_calibration writes it.')
@click.option('--fov-deg', type=float, help='Horizontal field of view, within 5 %.')
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML to start from, instead of --fov-deg.')
@click.option('--epoch', 'epoch_year', type=float,
              help='Julian year of the images, for proper motion.  [default: today]')
@click.option('--free', 'terms', multiple=True,
              type=click.Choice(['k1', 'centre', 'tangential', 'k2', 'k3']),
              help='Estimate just these beside the focal length.  [default: the data decide]')
@_json
def calibrate(images: tuple[Path, ...], output: Path, fov_deg: float | None,
              camera_file: Path | None, epoch_year: float | None, terms: tuple[str, ...],
              as_json: bool) -> None:
    """Focal length, principal point and distortion out of star IMAGES of one camera."""
    from startracker_ros.calibration.adjustment import CalibrationError
    from startracker_ros.calibration.files import calibrate_files
    from startracker_ros.camera import CameraError
    from startracker_ros.table import show
    if (fov_deg is None) == (camera_file is None):
        raise click.UsageError('give either --fov-deg or --camera')
    try:
        with _told(CalibrationError, output=output):
            result = calibrate_files(images, output, fov_deg=fov_deg, camera_file=camera_file,
                                     epoch_year=epoch_year, terms=terms)
    except CameraError as error:
        raise click.UsageError(str(error)) from error
    show(result, as_json)


@main.group(invoke_without_command=True)
@click.option('--output', type=click.Path(path_type=Path, file_okay=False), default='demo',
              show_default=True, help='Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(5, 3600), default=60.0, show_default=True,
              help='Sky time.')
@_seed
@_json
@click.pass_context
def demo(context: click.Context, output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Run all nodes on the simulated sky, record a bag, print and draw the result."""
    if context.invoked_subcommand is not None:
        return
    from startracker_ros.ros.demo import DemoError, run_demo
    with _told(DemoError):
        result = run_demo(output, seconds=seconds, seed=seed)
    _finish(result, as_json)


@demo.command('two-satellite')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              default='demo_two_satellite', show_default=True,
              help='Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(10, 90), default=60.0, show_default=True,
              help='Sky time, until the target leaves the field.')
@_seed
@_json
def demo_two_satellite(output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Two satellites, each with a star tracker of its own, locate a third."""
    from startracker_ros.ros.demo import DemoError
    from startracker_ros.ros.two_satellite_demo import run_two_satellite_demo
    with _told(DemoError):
        result = run_two_satellite_demo(output, seconds=seconds, seed=seed)
    _finish(result, as_json)


@main.command()
@click.argument('topics', nargs=-1, metavar='[TOPIC]...')
@click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False),
              help='Folder of the bag, made anew.  [default: startracker_<date>_<time>]')
@click.option('--exclude', multiple=True, metavar='PATTERN',
              help='Topics left out.  [default: */image_annotated]')
@click.option('--compression', type=click.Choice(['none', 'lz4', 'zstd']), default='zstd',
              show_default=True)
@click.option('--max-file-size-mb', type=click.FloatRange(0), default=0.0,
              help='Begin a new file of the bag when one is larger.')
@click.option('--max-file-duration-s', type=click.FloatRange(0), default=0.0,
              help='Begin a new file of the bag when one spans more.')
def record(topics: tuple[str, ...], output: Path | None, exclude: tuple[str, ...],
           compression: str, max_file_size_mb: float, max_file_duration_s: float) -> None:
    """Record TOPICs (patterns with *, all by default) into an MCAP bag, until Ctrl-C."""
    from startracker_ros.ros.processes import node_command, node_environment, parameter_arguments
    parameters = {'compression': compression, 'max_file_size_mb': max_file_size_mb,
                  'max_file_duration_s': max_file_duration_s}
    if output is not None:
        parameters['folder'] = str(output)
    if topics:
        parameters['topics'] = _full_names(topics)
    if exclude:
        parameters['exclude'] = _full_names(exclude)
    command = node_command('bag_recorder', parameter_arguments(parameters))
    os.execve(command[0], command, node_environment())


def _full_names(patterns: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(pattern if pattern[:1] in ('/', '*') else f'/{pattern}' for pattern in patterns)


@main.command()
@click.argument('bag', type=click.Path(path_type=Path))
@click.option('--topic', 'topics', multiple=True, metavar='PATTERN',
              help='Topics to play, * for any characters.  [default: all]')
@click.option('--exclude', multiple=True, metavar='PATTERN',
              help='Topics left out.  [default: /parameter_events, /rosout]')
@click.option('--remap', 'remaps', multiple=True, metavar='FROM:=TO', help='Rename a topic.')
@click.option('--rate', type=click.FloatRange(0.01, 1000), default=1.0, show_default=True,
              help='Times as fast as recorded.')
@click.option('--start-offset-s', type=click.FloatRange(0), default=0.0,
              help='Recorded time left out at the beginning.')
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
    from startracker_ros.ros.processes import node_command, node_environment, parameter_arguments
    parameters: dict[str, object] = {'path': str(bag), **options}
    if topics:
        parameters['topics'] = _full_names(topics)
    if exclude:
        parameters['exclude'] = _full_names(exclude)
    renamed = [word for remap in remaps for word in ('-r', remap)]
    command = node_command('bag_player', [*parameter_arguments(parameters), *renamed])
    os.execve(command[0], command, node_environment())


@main.command()
@click.argument('bag', type=click.Path(path_type=Path))
@click.option('--recover', 'output', metavar='OUT', type=click.Path(path_type=Path),
              help='Write all that is whole of an unfinished or damaged bag into a new one.')
@_json
def info(bag: Path, output: Path | None, as_json: bool) -> None:
    """List what a BAG (folder or .mcap file) holds; status 1 when it is not whole."""
    from startracker_ros.bag.errors import BagError
    from startracker_ros.bag.info import describe
    from startracker_ros.bag.recovery import recover
    from startracker_ros.table import show
    with _told(BagError):
        if output is not None:
            recover(bag, output, report=lambda problem: click.echo(problem, err=True))
            bag = output
        result, problems = describe(bag)
    show(result, as_json)
    for problem in problems:
        click.echo(f'startracker: {problem}', err=True)
    if problems:
        sys.exit(1)


@main.command()
@click.argument('bag', type=click.Path(path_type=Path))
@click.option('-o', '--output', type=click.Path(path_type=Path, dir_okay=False),
              default='report.html', show_default=True, help='Page to write.')
@_namespace
@_json
def report(bag: Path, output: Path, namespace: str | None, as_json: bool) -> None:
    """Write one HTML page of a BAG: attitude, errors, stars, states, times, frames."""
    from startracker_ros.bag.errors import BagError
    from startracker_ros.report.page import write_report
    from startracker_ros.table import show
    with _told(BagError, output=output):
        result = write_report(bag, output, namespace)
    show(result, as_json)


@main.command()
@click.argument('bag', type=click.Path(path_type=Path))
@click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False),
              default='export', show_default=True, help='Folder for the files.')
@click.option('--format', 'formats', multiple=True, default=('aem', 'csv'), show_default=True,
              type=click.Choice(['aem', 'csv', 'parquet']), help='One or more of them.')
@click.option('--originator', default='UNKNOWN', show_default=True, help='Of the AEM.')
@click.option('--object-name', default='UNKNOWN', show_default=True, help='In the AEM.')
@click.option('--object-id', default='UNKNOWN', show_default=True,
              help='In the AEM: the international designator.')
@_namespace
@_json
def export(bag: Path, output: Path, formats: tuple[str, ...], originator: str, object_name: str,
           object_id: str, namespace: str | None, as_json: bool) -> None:
    """Write attitude, tracks and diagnostics of a BAG as CCSDS AEM, CSV or Parquet."""
    from startracker_ros.bag.errors import BagError
    from startracker_ros.export.aem import AemError, AemLabels
    from startracker_ros.export.files import export_bag
    from startracker_ros.export.tables import MissingLibraryError
    from startracker_ros.table import show
    try:
        labels = AemLabels(originator, object_name, object_id)
    except AemError as error:
        raise click.UsageError(str(error)) from error
    with _told(BagError, AemError, MissingLibraryError, output=output):
        result = export_bag(bag, output, formats, labels, namespace)
    show(result, as_json)


@main.command()
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML to look at, too.')
@click.option('--listen', 'listen_s', type=click.FloatRange(0.5, 600), metavar='SECONDS',
              help='Listen to image_raw and camera_info for so long.')
@click.option('--namespace', default='', help='That of the camera, as tracker_1.')
@_json
def doctor(camera_file: Path | None, listen_s: float | None, namespace: str, as_json: bool
           ) -> None:
    """Look at install, DDS, caches, disk and camera; say what to mend."""
    from startracker_ros.doctor.examination import examine
    _finish(examine(camera_file=camera_file, listen_s=listen_s or 0.0, namespace=namespace),
            as_json)


@main.group()
def campaign() -> None:
    """Repeat the published tables, the paper's figure beside ours."""


@campaign.command('hausdorff')
@click.option('--trials', type=click.IntRange(1), default=200, show_default=True,
              help='Directions of each figure.')
@_scheduler
@_seed
@_json
def campaign_hausdorff(trials: int, scheduler: str, seed: int, as_json: bool) -> None:
    """Find sets of bright stars by their Hausdorff distance in a field of 12 deg."""
    from startracker_ros.campaign.hausdorff import run_hausdorff_campaign
    _finish(run_hausdorff_campaign(trials=trials, seed=seed, scheduler=scheduler), as_json)


@campaign.command('quad')
@click.option('--trials', type=click.IntRange(1), default=300, show_default=True,
              help='Frames along the orbit, and as many of the whole sky.')
@_scheduler
@_seed
@_json
def campaign_quad(trials: int, scheduler: str, seed: int, as_json: bool) -> None:
    """Quads of stars found by k-vector in a field of 20.3 deg."""
    from startracker_ros.campaign.quad import run_quad_campaign
    _finish(run_quad_campaign(trials=trials, seed=seed, scheduler=scheduler), as_json)


@campaign.command('extended-grid')
@click.option('--trials', type=click.IntRange(1), default=10000, show_default=True,
              help='Directions of each figure.')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              help='Folder for a picture of the two curves.')
@_scheduler
@_seed
@_json
def campaign_extended_grid(trials: int, output: Path | None, scheduler: str, seed: int,
                           as_json: bool) -> None:
    """Fields of 4 deg with few stars, known by a gyro and grids beyond the edge."""
    from startracker_ros.campaign.extended_grid import run_extended_grid_campaign
    _finish(run_extended_grid_campaign(trials=trials, seed=seed, scheduler=scheduler,
                                       output=output), as_json)


@campaign.command('jpdaf')
@click.option('--trials', type=click.IntRange(1), default=100, show_default=True,
              help='Runs of 400 frames in each cell.')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              help='Folder for a picture of the errors over the frames.')
@_scheduler
@_seed
@_json
def campaign_jpdaf(trials: int, output: Path | None, scheduler: str, seed: int,
                   as_json: bool) -> None:
    """Four stars tracked by JPDAF through turns, straight lines and jitter."""
    from startracker_ros.campaign.jpdaf import run_jpdaf_campaign
    _finish(run_jpdaf_campaign(trials=trials, seed=seed, scheduler=scheduler, output=output),
            as_json)


@campaign.command('two-satellite')
@click.option('--trials', type=click.IntRange(1000), default=100000, show_default=True,
              help='Draws of the figures beyond the 500 of the paper.')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              help='Folder for a picture of the error over the baseline.')
@_seed
@_json
def campaign_two_satellite(trials: int, output: Path | None, seed: int, as_json: bool) -> None:
    """Locate a target by the cameras of two satellites under four sources of error."""
    from startracker_ros.campaign.two_satellite import run_two_satellite_campaign
    _finish(run_two_satellite_campaign(trials=trials, seed=seed, output=output), as_json)


@campaign.command('integrity')
@click.option('--trials', type=click.IntRange(1), default=15, show_default=True,
              help='Runs of 400 frames in each condition: 15 make 100,000 frames in all.')
@click.option('--only', multiple=True, help='Conditions to run, by name.')
@_scheduler
@_seed
@_json
def campaign_integrity(trials: int, only: tuple[str, ...], scheduler: str, seed: int,
                       as_json: bool) -> None:
    """Wrong attitudes counted in slews, darkness, false stars, lying gyros, wrong cameras."""
    from startracker_ros.campaign.integrity import CONDITIONS, run_integrity_campaign
    _check_names('condition', only, CONDITIONS)
    _finish(run_integrity_campaign(trials=trials, seed=seed, only=only, scheduler=scheduler),
            as_json)


@campaign.command('faults')
@click.option('--only', multiple=True, help='Faults to do, by name.')
@_seed
@_json
def campaign_faults(only: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Kill and stop processes, send bad images, clocks and disks: see how the nodes recover."""
    from startracker_ros.campaign.faults import NAMES, run_faults_campaign
    from startracker_ros.ros.processes import RigError
    _check_names('fault', only, NAMES)
    with _told(RigError):
        result = run_faults_campaign(seed=seed, only=only)
    _finish(result, as_json)


@campaign.command('soak')
@click.option('--frames', type=click.IntRange(500), default=100_000, show_default=True,
              help='Frames to send.')
@_seed
@_json
def campaign_soak(frames: int, seed: int, as_json: bool) -> None:
    """Many frames through the nodes: memory, handles, processor time and latency stay flat."""
    from startracker_ros.campaign.soak import run_soak_campaign
    from startracker_ros.ros.processes import RigError
    with _told(RigError):
        result = run_soak_campaign(frames=frames, seed=seed)
    _finish(result, as_json)


@campaign.command('centroid')
@click.option('--images', 'folder', metavar='FOLDER',
              type=click.Path(path_type=Path, exists=True, file_okay=False),
              help='Images with a solutions.csv.  [default: night-sky-11deg of STARTRACKER_DATA]')
@_json
def campaign_centroid(folder: Path | None, as_json: bool) -> None:
    """Weighted means at right and wrong thresholds on real photographs."""
    from startracker_ros.campaign.centroid import DataError, run_centroid_campaign
    with _told(DataError):
        result = run_centroid_campaign(folder)
    _finish(result, as_json)


@main.group()
def bench() -> None:
    """Measure speed and accuracy beside peers and physical bounds."""


def _bench(function: Callable[..., None]) -> Callable[..., None]:
    function = click.option('--trials', type=click.IntRange(1), default=1000, show_default=True,
                            help='Frames of each case.')(function)
    function = click.option('--only', multiple=True, help='Cases to run, by name.')(function)
    return _seed(_json(function))


@bench.command('pipeline')
@_bench
def bench_pipeline(trials: int, seed: int, only: tuple[str, ...], as_json: bool) -> None:
    """Accuracy against the Cramer-Rao bound, identification, start-up, frame times."""
    from startracker_ros.bench.pipeline import CASES, run_pipeline_bench
    from startracker_ros.ros.processes import RigError
    _check_names('case', only, CASES)
    with _told(RigError):
        result = run_pipeline_bench(trials=trials, seed=seed, only=only or tuple(CASES))
    _finish(result, as_json)


@bench.command('lost-in-space')
@click.option('--all-cells', is_flag=True, help='Every combination of noise, missing and false.')
@click.option('--camera', 'cameras', multiple=True, help='Cameras to run: A12, B20, C10.')
@click.option('--cedar-python', type=click.Path(exists=True, dir_okay=False),
              help="Python of a venv with cedar-solve and 'numpy<2', to run that peer as well.")
@_scheduler
@_bench
def bench_lost_in_space(all_cells: bool, cameras: tuple[str, ...], cedar_python: str | None,
                        scheduler: str, trials: int, seed: int, only: tuple[str, ...],
                        as_json: bool) -> None:
    """Identification beside tetra3rs and cedar-solve, on the same frames."""
    from startracker_ros.bench.corpus import ALL_CELLS, CELLS, VIEWS
    from startracker_ros.bench.lost_in_space import DATABASE, run_lost_in_space_bench
    from startracker_ros.bench.peers import PeerError
    for kind, named, known in (('case', only, (DATABASE, *ALL_CELLS)), ('camera', cameras, VIEWS)):
        _check_names(kind, named, known)
    if cedar_python and scheduler:
        raise click.UsageError('cedar-solve runs on this machine, without --scheduler')
    chosen = only or (DATABASE, *(ALL_CELLS if all_cells else CELLS))
    with _told(PeerError):
        result = run_lost_in_space_bench(
            trials=trials, seed=seed, only=chosen, cameras=cameras or tuple(VIEWS),
            cedar_python=cedar_python or '', scheduler=scheduler)
    _finish(result, as_json)


@bench.command('bag')
@click.option('--inputs', type=click.IntRange(1), default=100_000, show_default=True,
              help='Damaged bags to read.')
@click.option('--only', multiple=True, type=click.Choice(['damage', 'pace', 'record']),
              help='Parts to run.')
@_seed
@_json
def bench_bag(inputs: int, only: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Damaged bags, the pace of a playback, the cost of recording images."""
    from startracker_ros.bench.bag import CASES, run_bag_bench
    _finish(run_bag_bench(inputs=inputs, seed=seed, only=only or CASES), as_json)


@bench.command('centroid')
@click.option('--trials', type=click.IntRange(1), default=100, show_default=True,
              help='Images of each signal to noise ratio.')
@click.option('--snr', 'snrs', multiple=True, type=click.FloatRange(1, 1000),
              help='Signal to noise ratios of the stars.  [default: 7, 10, 30, 100, 300]')
@_seed
@_json
def bench_centroid(trials: int, snrs: tuple[float, ...], seed: int, as_json: bool) -> None:
    """Time, stars found and error of centroids beside sep, photutils and tetra3rs."""
    from startracker_ros.bench.centroid import run_centroid_bench, SNRS
    _finish(run_centroid_bench(trials=trials, seed=seed, snrs=snrs or SNRS), as_json)


@bench.command('jpda')
@click.option('--trials', type=click.IntRange(1), default=5, show_default=True,
              help='Runs of each scene.')
@click.option('--scene', 'scenes', multiple=True,
              type=click.Choice(['apart', 'crossing', 'close']), help='Scenes to run.')
@click.option('--tracks', multiple=True, type=click.IntRange(2, 500),
              help='Numbers of tracks.  [default: 4, 10, 20, 40, 100, 200]')
@_seed
@_json
def bench_jpda(trials: int, scenes: tuple[str, ...], tracks: tuple[int, ...], seed: int,
               as_json: bool) -> None:
    """Time, error and swapped tracks of the JPDA filter beside Stone Soup."""
    from startracker_ros.bench.jpda import run_jpda_bench, TRACKS
    from startracker_ros.bench.moving_targets import SCENES
    _finish(run_jpda_bench(trials=trials, seed=seed, scenes=scenes or SCENES,
                           tracks=tracks or TRACKS), as_json)


@bench.command('attitude')
@click.option('--trials', type=click.IntRange(1), default=2000, show_default=True,
              help='Draws of each number of vectors.')
@click.option('--vectors', multiple=True, type=click.IntRange(2, 1000),
              help='Numbers of vectors.  [default: 4, 20, 40]')
@_seed
@_json
def bench_attitude(trials: int, vectors: tuple[int, ...], seed: int, as_json: bool) -> None:
    """Time, error and covariance of the attitude solvers beside SciPy's align_vectors."""
    from startracker_ros.bench.attitude import run_attitude_bench, VECTORS
    _finish(run_attitude_bench(trials=trials, seed=seed, vectors=vectors or VECTORS), as_json)
