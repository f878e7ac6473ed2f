# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands about an instrument that need not exist: datasheet, design."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from startracker_ros.core.extras import new_figure
from startracker_ros.io.output import check_output
from startracker_ros.tools.cli.outcome import exit_1_on, InputPath, usage_error_on
from startracker_ros.tools.cli.shared import (
    finish_measured as finish, json_option, output_option, scheduler_option, seed_option,
    trials_option)
from startracker_ros.tools.datasheet.design_options import DesignOptions


@click.command()
@click.option('--camera', 'camera_file', type=InputPath(),
              help='Camera YAML.  [default: 1024 x 1024 px, 12 deg]')
@click.option('--optics', 'optics_file', type=InputPath(),
              help='YAML with options of the detector of sky_simulator: PSF, exposure, noise.')
@click.option('--quick', is_flag=True, help='Simulate little: a minute, wide intervals.')
@output_option('datasheet.html', 'The page.', folder=False)
@scheduler_option
@seed_option
@json_option
def datasheet(camera_file: Path | None, optics_file: Path | None, quick: bool, output: Path,
              scheduler: str, seed: int, as_json: bool) -> None:
    """Simulate what a data sheet states of a camera: accuracy, acquisition, limits, coverage."""
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
        unit = f' ({row.unit})' if row.unit else ''
        command = click.option(
            f'--{row.name.replace("_", "-")}', row.name, type=type(row.default),
            default=row.default, show_default=True, help=row.description + unit)(command)
    return command


@click.command()
@_design_options
@trials_option(40, 'Fields of the Monte Carlo.')
@scheduler_option
@seed_option
@json_option
def design(trials: int, scheduler: str, seed: int, as_json: bool, **values: Any) -> None:
    """Field, stars, best exposure and accuracy that a sensor and a lens would have."""
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.tools.datasheet.design import DesignError, run_design
    with usage_error_on(ValueError):
        options = DesignOptions(**values)
    with usage_error_on(CameraError, DesignError):
        result = run_design(options, trials=trials, seed=seed, scheduler=scheduler)
    finish(result, as_json)
