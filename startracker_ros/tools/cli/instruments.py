# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands about an instrument that need not exist: datasheet, design, sky."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from startracker_ros.core.extras import new_figure
from startracker_ros.io.output import check_output
from startracker_ros.tools.cli.outcome import (
    EpochYear, exit_1_on, FOV_DEG, InputPath, usage_error_on)
from startracker_ros.tools.cli.shared import (
    finish_measured as finish, json_option, output_option, print_result, scheduler_option,
    seed_option, trials_option)
from startracker_ros.tools.datasheet.design_options import DesignOptions


@click.command()
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML.  [default: 1024 x 1024 px, 12 deg]')
@click.option('--optics', 'optics_file', type=InputPath(), metavar='FILE',
              help='YAML with options of the detector of sky_simulator: PSF, exposure, noise.')
@click.option('--quick', is_flag=True, help='Simulate little: a minute, wide intervals.')
@output_option('datasheet.html', 'The page.', folder=False)
@scheduler_option
@seed_option
@json_option
def datasheet(camera_file: Path | None, optics_file: Path | None, quick: bool, output: Path,
              scheduler: str, seed: int, as_json: bool) -> None:
    """Simulate the data sheet of a camera: accuracy, limits, coverage."""
    from startracker_ros.core.calibration.adjustment import CalibrationError
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.io.images.camera_files import load_camera
    from startracker_ros.tools.datasheet.datasheet import FULL, QUICK, run_datasheet
    from startracker_ros.tools.datasheet.instrument import (
        DEFAULT_CAMERA, DETECTOR, load_optics, OpticsError)
    from startracker_ros.tools.datasheet.rows import records
    with usage_error_on(CameraError, OpticsError):
        lens = DEFAULT_CAMERA if camera_file is None else load_camera(camera_file)
        detector = DETECTOR if optics_file is None else load_optics(optics_file)
    with exit_1_on(CalibrationError, output=output):
        # Before the long work, not after it.
        new_figure()
        check_output(output)
        result = run_datasheet(lens, detector, output, seed=seed,
                               effort=QUICK if quick else FULL, scheduler=scheduler)
    # For people a figure is a line; the page has the intervals and the published figures.
    finish(result if as_json else replace(result, rows=records(result.rows)), as_json)


def _design_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option of the command for each of the design."""
    for row in reversed(DesignOptions.table()):
        kind: Any = click.IntRange if isinstance(row.default, int) else click.FloatRange
        command = click.option(
            f'--{row.name.replace("_", "-")}', row.name, type=kind(row.low, row.high),
            default=row.default, show_default=True, metavar=row.unit.upper() or 'VALUE',
            help=f'{row.description[0].upper()}{row.description[1:]}.')(command)
    return command


@click.command()
@_design_options
@trials_option(40, 'Fields of the Monte Carlo.')
@scheduler_option
@seed_option
@json_option
def design(trials: int, scheduler: str, seed: int, as_json: bool, **values: Any) -> None:
    """
    Compute the accuracy that a sensor and a lens would have.

    Field of view, stars and best exposure, too.
    """
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.tools.datasheet.design import DesignError, run_design
    with usage_error_on(ValueError):
        options = DesignOptions(**values)
    with usage_error_on(CameraError, DesignError):
        result = run_design(options, trials=trials, seed=seed, scheduler=scheduler)
    finish(result, as_json)


@click.command()
@click.option('-o', '--output', required=True, type=click.Path(path_type=Path, dir_okay=False),
              help='Sky file to write.')
@click.option('--fov-deg', type=FOV_DEG, metavar='DEG',
              help='Horizontal field of view of 1024 x 1024 px.  [default: 12]')
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML, instead of --fov-deg.')
@click.option('--epoch', 'epoch_year', type=EpochYear(),
              help='Julian year or UTC of the star places, rounded to a year.  '
              '[default: this year]')
@click.option('--band', type=click.Choice(['V', 'Hp', 'G']), default='V', show_default=True,
              help='Band of the magnitudes.')
@click.option('--magnitude-limit', type=click.FloatRange(0, 11), metavar='MAG',
              help='Faintest stars of the pairs.  [default: a field holds twenty on average]')
@click.option('--fov-error-percent', type=click.FloatRange(0, 5), metavar='PERCENT',
              help='Tolerance of the focal length, for which there are pairs.  [default: 0.5]')
@json_option
def sky(output: Path, fov_deg: float | None, camera_file: Path | None, epoch_year: float | None,
        band: str, as_json: bool, **limits: Any) -> None:
    """
    Write the sky file of the native core for a camera.

    Stars, cells, pairs of stars. It serves all cameras of this field and these pixels.
    """
    if fov_deg is not None and camera_file is not None:
        raise click.UsageError('give either --fov-deg or --camera')
    from startracker_ros.core.astro.epoch import epoch_year_now
    from startracker_ros.core.camera.model import Camera, CameraError
    from startracker_ros.core.catalog.band import BandOptions
    from startracker_ros.core.identify.identification import IdentificationOptions
    from startracker_ros.core.native import NativeError
    from startracker_ros.io.images.camera_files import load_camera
    from startracker_ros.tools.catalogue.sky_file import write_sky
    with usage_error_on(CameraError):
        camera = (Camera.from_fov(1024, 1024, fov_deg or 12.0) if camera_file is None
                  else load_camera(camera_file))
    with usage_error_on(ValueError):
        options = IdentificationOptions(**{
            name: limit for name, limit in limits.items() if limit is not None})
    with usage_error_on(CameraError), exit_1_on(NativeError, output=output):
        # Before the long work, not after it.
        check_output(output)
        result = write_sky(camera, output, epoch_year or epoch_year_now(), options,
                           BandOptions(band))
    print_result(result, as_json)
