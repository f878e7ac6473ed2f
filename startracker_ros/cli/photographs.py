"""Commands that take image files: solve, calibrate."""

from pathlib import Path
import sys

import click
from startracker_ros.cli.shared import exit_1_on, json_option, usage_error_on

_epoch_option = click.option(
    '--epoch', 'epoch_year', type=float,
    help='Julian year of the images, for proper motion.  [default: today]')


def _check_one_camera(fov_deg: float | None, camera_file: Path | None) -> None:
    if (fov_deg is None) == (camera_file is None):
        raise click.UsageError('give either --fov-deg or --camera')


@click.command()
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('--fov-deg', type=float, help='Horizontal field of view, edge to edge.')
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML as camera_calibration writes it, instead of --fov-deg.')
@click.option('--fov-error-percent', type=click.FloatRange(0, 5), default=0.5,
              show_default=True, help='How far the field of view may be off.')
@_epoch_option
@click.option('--annotate', 'annotate_folder', type=click.Path(path_type=Path),
              help='Folder for a PNG of each image with the identified stars.')
@json_option
def solve(images: tuple[Path, ...], fov_deg: float | None, camera_file: Path | None,
          fov_error_percent: float, epoch_year: float | None, annotate_folder: Path | None,
          as_json: bool) -> None:
    """Attitude of star IMAGES: right ascension, declination, roll, stars, residual."""
    from startracker_ros.camera.model import CameraError
    from startracker_ros.identify.identification import IdentificationOptions
    from startracker_ros.pipeline.solve import solve_files
    from startracker_ros.table import show
    _check_one_camera(fov_deg, camera_file)
    with usage_error_on(CameraError):
        result = solve_files(images, fov_deg=fov_deg, camera_file=camera_file,
                             epoch_year=epoch_year, annotate_folder=annotate_folder,
                             options=IdentificationOptions(fov_error_percent=fov_error_percent))
    show(result, as_json)
    if not all(row['solved'] for row in result.rows):
        sys.exit(1)


@click.command()
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('-o', '--output', required=True, type=click.Path(path_type=Path, dir_okay=False),
              help='Camera YAML to write, as camera_calibration writes it.')
@click.option('--fov-deg', type=float, help='Horizontal field of view, within 5 %.')
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML to start from, instead of --fov-deg.')
@_epoch_option
@click.option('--free', 'terms', multiple=True,
              type=click.Choice(['k1', 'centre', 'tangential', 'k2', 'k3']),
              help='Estimate just these beside the focal length.  [default: the data decide]')
@json_option
def calibrate(images: tuple[Path, ...], output: Path, fov_deg: float | None,
              camera_file: Path | None, epoch_year: float | None, terms: tuple[str, ...],
              as_json: bool) -> None:
    """Focal length, principal point and distortion out of star IMAGES of one camera."""
    from startracker_ros.calibration.adjustment import CalibrationError
    from startracker_ros.calibration.files import calibrate_files
    from startracker_ros.camera.model import CameraError
    from startracker_ros.table import show
    _check_one_camera(fov_deg, camera_file)
    with usage_error_on(CameraError), exit_1_on(CalibrationError, output=output):
        result = calibrate_files(images, output, fov_deg=fov_deg, camera_file=camera_file,
                                 epoch_year=epoch_year, terms=terms)
    show(result, as_json)
