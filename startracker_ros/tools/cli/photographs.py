# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that take image files: solve, calibrate, night."""

from collections.abc import Callable
import math
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING, TypeVar

import click
from startracker_ros.core.astro.constants import MAX_SPEED_M_S
from startracker_ros.io.output import check_output
from startracker_ros.photographs.searched_fields import (
    HIGHEST_DEG, LOWEST_DEG, TILED_HIGHEST_DEG, TILED_LOWEST_DEG)
from startracker_ros.tools.cli.outcome import (
    EpochYear, exit_1_on, FOV_DEG, InputPath, NeedsArguments, require_some, usage_error_on)
from startracker_ros.tools.cli.shared import json_option, namespace_option, print_result

if TYPE_CHECKING:
    from startracker_ros.photographs.epoch_and_site import ObserverSite

_Command = TypeVar('_Command', bound=Callable[..., Any])


class _Frames(click.ParamType):
    """Frames like 0:100:10, a slice."""

    name = 'frames'

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> slice:
        if isinstance(value, slice):
            return value
        try:
            chosen = slice(*(int(part) if part else None for part in value.split(':')))
        except (TypeError, ValueError):
            self.fail(f'{value!r} is not a FIRST:END:STEP')
        least = min(chosen.start or 0, chosen.stop or 0)
        if ':' not in value or least < 0 or chosen.step is not None and chosen.step < 1:
            self.fail(f'{value!r} is not a FIRST:END:STEP that counts from 0 upwards')
        return chosen


def _observer_options(epoch_default: str, *, flying: bool = True
                      ) -> Callable[[_Command], _Command]:
    """Return options for when the images were taken, and from where, flying or on the ground."""
    velocity = click.option('--velocity', 'velocity_km_s', type=float, nargs=3, metavar='VX VY VZ',
                            help='Velocity of the camera about the Earth on ICRF axes, for '
                            f'aberration, km/s; at most {MAX_SPEED_M_S / 1e3:g}.')

    def add(function: _Command) -> _Command:
        for option in (
                click.option('--temperature-c', type=float, default=10.0, show_default=True,
                             metavar='DEG_C',
                             help='Temperature of the air at the site.'),
                click.option('--pressure-hpa', type=click.FloatRange(0, 1200), default=None,
                             metavar='HPA',
                             help='Pressure of the air at the site, 0 for no refraction.  '
                             '[default: standard atmosphere at its height]'),
                *((velocity,) if flying else ()),
                click.option('--site', type=float, nargs=3, metavar='LAT LON HEIGHT',
                             help='Camera on the ground, for aberration and refraction: latitude '
                             'and longitude in deg, east positive, height in m.  [-90<=LAT<=90; '
                             '-360<=LON<=360; -500<=HEIGHT<=100000]'),
                click.option('--epoch', 'epoch_year', type=EpochYear(),
                             help='Julian year or UTC (2026-11-23T01:30Z) of the images, for '
                             f'proper motion and aberration.  [default: {epoch_default}]')):
            function = option(function)
        return function
    return add


def _check_observer(site: tuple[float, float, float] | None,
                    velocity_km_s: tuple[float, float, float] | None = None, **_: float) -> None:
    """Raise UsageError for options that are wrong, or do not go together."""
    if site is not None and velocity_km_s is not None:
        raise click.UsageError('give either --site or --velocity')
    if site is not None and not (
            abs(site[0]) <= 90 and abs(site[1]) <= 360 and -500 <= site[2] <= 100e3):
        raise click.UsageError(f'--site {site}: no latitude, longitude and height in m')
    if velocity_km_s is not None and not 1e3 * math.hypot(*velocity_km_s) <= MAX_SPEED_M_S:
        raise click.UsageError(f'--velocity: more than {MAX_SPEED_M_S / 1e3:g} km/s '
                               'about the Earth')


def _observer_site(site: tuple[float, float, float] | None, pressure_hpa: float | None,
                   temperature_c: float,
                   velocity_km_s: tuple[float, float, float] | None = None) -> 'ObserverSite':
    """Return where the camera was."""
    import numpy as np
    from startracker_ros.core.astro.ground_site import Site
    from startracker_ros.photographs.epoch_and_site import ObserverSite
    return ObserverSite(
        None if site is None else Site(*site, pressure_hpa, temperature_c),
        None if velocity_km_s is None else 1e3 * np.array(velocity_km_s))


def _image_files(images: tuple[Path, ...]) -> list[Path]:
    """Return the files of IMAGES: files, folders of them, patterns; UsageError without any."""
    from startracker_ros.io.images.images import image_paths
    paths = image_paths(images)
    if not paths:
        raise click.UsageError(f'no images in {", ".join(map(str, images))}')
    return paths


_EXAMPLES = """\b
Examples:
  startracker solve night.jpg
  startracker solve night.jpg --fov-deg 11.4 --annotate marked
  startracker solve *.png --camera camera.yaml --json
"""


@click.command(cls=NeedsArguments, no_args_is_help=True, epilog=_EXAMPLES)
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('--fov-deg', type=FOV_DEG, metavar='DEG',
              help='Horizontal field of view, edge to edge; one that does not fit is dropped.  '
              '[default: EXIF, then a search from '
              f'{LOWEST_DEG:g} to {HIGHEST_DEG:g} deg, then of fisheyes]')
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML as camera_calibration writes it, or FITS header with SIP, '
              'instead of --fov-deg.')
@click.option('--fov-error-percent', type=click.FloatRange(0, 5), metavar='PERCENT',
              help='Largest error of the field of view.  [default: 5, with --camera 0.5]')
@_observer_options('time in the file, EXIF or DATE-OBS, else today without aberration')
@click.option('--catalogue', type=InputPath(file_okay=False), metavar='FOLDER',
              help='Folder that `startracker catalogue` has written: images of '
              f'{TILED_LOWEST_DEG:g} to {TILED_HIGHEST_DEG:g} deg are searched there first.')
@click.option('--near', 'near_deg', type=float, nargs=2, metavar='RA DEC',
              help='Where the images are, in deg, within 5 deg: faster with --catalogue.  '
              '[default: OBJCTRA and OBJCTDEC, or RA and DEC, of a FITS header]')
@click.option('--mirror', is_flag=True, help='Flip images from left to right first: those of a '
              'telescope with one mirror too many.')
@click.option('--dark', 'dark_file', type=click.Path(path_type=Path), metavar='FILE',
              help='Dark frame to subtract, an image of the same size; or bad pixels, a .txt or '
              '.csv file with u,v on each line.')
@click.option('--frames', 'selection', type=_Frames(), default=':', metavar='FIRST:END:STEP',
              help='Frames of videos and animated images, numbered from 0, as of a slice in '
              'Python.  [default: all]')
@click.option('--annotate', 'annotate_folder', type=click.Path(path_type=Path), metavar='FOLDER',
              help='Folder for a PNG of each image with the identified stars.')
@click.option('--deep-sky', is_flag=True, help='Name Messier, NGC and IC objects in the PNG of '
              '--annotate; needs PyOngc.')
@click.option('--wcs', 'wcs_folder', type=click.Path(path_type=Path), metavar='FOLDER',
              help='Folder for a FITS header of each solved image: TAN-SIP, of fisheyes ZPN.')
@json_option
def solve(images: tuple[Path, ...], fov_deg: float | None, camera_file: Path | None,
          fov_error_percent: float | None, epoch_year: float | None, mirror: bool,
          selection: slice, annotate_folder: Path | None, deep_sky: bool,
          wcs_folder: Path | None, as_json: bool, catalogue: Path | None,
          near_deg: tuple[float, float] | None, dark_file: Path | None,
          **observer_site: Any) -> None:
    """
    Find attitude and lens of star IMAGES.

    Right ascension, declination, roll, stars, residual. IMAGES are files, folders of them, or
    patterns. Each frame of a video is an image.
    """
    if fov_deg is not None and camera_file is not None:
        raise click.UsageError('give either --fov-deg or --camera')
    if catalogue is not None and camera_file is not None:
        raise click.UsageError('give either --catalogue or --camera: with a catalogue the lens is '
                               'fitted')
    if deep_sky and annotate_folder is None:
        raise click.UsageError('--deep-sky is for pictures: give --annotate as well')
    if near_deg is not None and catalogue is None:
        raise click.UsageError('--near is for narrow fields: give --catalogue as well')
    if near_deg is not None and not (abs(near_deg[0]) <= 360 and abs(near_deg[1]) <= 90):
        raise click.UsageError(f'--near {near_deg}: no right ascension and declination in deg')
    _check_observer(**observer_site)
    require_some(images)
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.core.identify.identification import IdentificationOptions
    from startracker_ros.io.images.images import ImageError
    from startracker_ros.photographs.solve import (
        CALIBRATED_PERCENT, Outputs, PHOTOGRAPH_LIMIT_S, solve_files, UNCALIBRATED_PERCENT)
    from startracker_ros.photographs.tiles import CatalogueError
    paths = _image_files(images)
    if fov_error_percent is None:
        fov_error_percent = UNCALIBRATED_PERCENT if camera_file is None else CALIBRATED_PERCENT
    with usage_error_on(CameraError), exit_1_on(CatalogueError, ImageError):
        result = solve_files(paths, fov_deg=fov_deg, camera_file=camera_file,
                             epoch_year=epoch_year, observer_site=_observer_site(**observer_site),
                             mirror=mirror, selection=selection,
                             outputs=Outputs(annotate_folder, wcs_folder, deep_sky),
                             catalogue=catalogue, near_deg=near_deg, dark_file=dark_file,
                             options=IdentificationOptions(
                                 fov_error_percent=fov_error_percent,
                                 time_limit_s=PHOTOGRAPH_LIMIT_S))
    print_result(result, as_json)
    for row in result.rows:
        if row['not_written']:
            click.echo(f'startracker: {row["file"]}: {row["not_written"]}', err=True)
    if not all(row['solved'] and not row['not_written'] for row in result.rows):
        sys.exit(1)


class _Column(click.ParamType):
    """ROLE=NAME, a column of a star catalogue."""

    name = 'role=name'

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> tuple[str, str]:
        from startracker_ros.io.star_tables import ROLES
        role, mark, name = str(value).partition('=')
        if role not in ROLES or not mark or not name:
            self.fail(f'{value!r} is not a ROLE=NAME with one of the roles {", ".join(ROLES)}')
        return role, name


_CATALOGUE_EXAMPLES = """\b
Examples:
  startracker catalogue gaia.parquet -o ~/gaia14 --faintest 14
  startracker catalogue ucac4.csv -o ~/ucac --column magnitude=f.mag --epoch 2000
  startracker solve image.fits --catalogue ~/gaia14
"""


@click.command(cls=NeedsArguments, no_args_is_help=True, epilog=_CATALOGUE_EXAMPLES)
@click.argument('files', nargs=-1, required=True, type=InputPath())
@click.option('-o', '--output', required=True, type=click.Path(path_type=Path), metavar='FOLDER',
              help='Folder to write; a catalogue that is there is replaced.')
@click.option('--column', 'columns', type=_Column(), multiple=True, metavar='ROLE=NAME',
              help='Name of a column that is not recognised: ra and dec in deg, magnitude, pmra '
              'and pmdec in mas/yr, epoch.')
@click.option('--epoch', 'epoch_year', type=EpochYear(),
              help='Julian year or UTC of the positions.  [default: the column ref_epoch]')
@click.option('--faintest', type=float, default=None, metavar='MAG',
              help='Leave fainter stars out, magnitude.  [default: all]')
@click.option('--least-deg', type=click.FloatRange(0.1, 1.5), default=TILED_LOWEST_DEG,
              show_default=True, metavar='DEG',
              help='Narrowest field of view, long side, that is searched without a position.')
@click.option('--blind/--no-blind', default=True, show_default=True,
              help='Whether images without a position can be searched: of all the sky and from '
              '0.3 deg on this takes 1 GB, from 0.6 deg less than half of it.')
@json_option
def catalogue(files: tuple[Path, ...], output: Path, columns: tuple[tuple[str, str], ...],
              epoch_year: float | None, faintest: float | None, least_deg: float, blind: bool,
              as_json: bool) -> None:
    """
    Make a catalogue for narrow fields from tables of stars.

    FILES are CSV, FITS or Parquet. `startracker solve --catalogue FOLDER` searches it.
    """
    from startracker_ros.photographs.tiles import CatalogueError
    from startracker_ros.tools.catalogue.build import build_catalogue
    with exit_1_on(CatalogueError, output=output):
        result = build_catalogue(
            files, output, columns=dict(columns), epoch_year=epoch_year,
            faintest=float('inf') if faintest is None else faintest, least_deg=least_deg,
            blind=blind)
    print_result(result, as_json)


@click.command()
@click.argument('images', nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option('-o', '--output', required=True, type=click.Path(path_type=Path, dir_okay=False),
              help='Camera YAML to write, as camera_calibration writes it.')
@click.option('--fov-deg', type=FOV_DEG, metavar='DEG',
              help='Horizontal field of view, within 5 %; a fisheye needs none.')
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML, or FITS header with SIP, to start from instead of --fov-deg.')
@_observer_options('today, without aberration')
@click.option('--distortion-model', type=click.Choice(['plumb_bob', 'equidistant']),
              default='plumb_bob', show_default=True,
              help='Lens without --camera; equidistant for fisheyes, of any projection.')
@click.option('--free', 'terms', multiple=True,
              type=click.Choice(['k1', 'centre', 'tangential', 'k2', 'k3', 'k4']),
              help='Estimate the focal length and just these.  [default: the data decide]')
@json_option
def calibrate(images: tuple[Path, ...], output: Path, fov_deg: float | None,
              camera_file: Path | None, epoch_year: float | None, terms: tuple[str, ...],
              distortion_model: str, as_json: bool, **observer_site: Any) -> None:
    """
    Fit the lens of a camera to star IMAGES.

    Focal length, principal point and distortion. IMAGES are files, folders of them, or patterns.
    """
    unknown = fov_deg is None and camera_file is None
    if (unknown and distortion_model != 'equidistant'
            or fov_deg is not None and camera_file is not None):
        raise click.UsageError('give either --fov-deg or --camera')
    if epoch_year is None and (observer_site['site'] or observer_site['velocity_km_s']):
        raise click.UsageError('--site and --velocity need --epoch')
    _check_observer(**observer_site)
    require_some(images)
    from startracker_ros.core.calibration.adjustment import CalibrationError
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.photographs.calibrate import calibrate_files
    from startracker_ros.photographs.epoch_and_site import epoch_of
    with usage_error_on(CameraError), exit_1_on(CalibrationError, output=output):
        check_output(output)
        result = calibrate_files(_image_files(images), output, fov_deg=fov_deg,
                                 camera_file=camera_file, epoch_year=epoch_year,
                                 observer=_observer_site(**observer_site).observer(
                                     epoch_of(epoch_year)), terms=terms,
                                 distortion_model=distortion_model)
    print_result(result, as_json)


@click.command()
@click.argument('source', type=InputPath(), metavar='BAG|FOLDER|VIDEO')
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML, or FITS header with SIP.  [default: camera_info of the bag]')
@click.option('--tracking', is_flag=True, help='The mount turns at a constant unknown rate about '
              'a constant axis; without it the camera stands still on the Earth.')
@_observer_options('stamps of the bag, EXIF or DATE-OBS', flying=False)
@click.option('--interval-s', type=click.FloatRange(1e-3, 3600), default=None, metavar='SECONDS',
              help='Time between two images of a folder or a video.  [default: by their own '
              'times]')
@click.option('--datasheet', type=InputPath(dir_okay=False),
              help='What `startracker datasheet --json` printed of the camera, for the column '
              'simulated.')
@namespace_option
@json_option
def night(source: Path, camera_file: Path | None, tracking: bool, epoch_year: float | None,
          interval_s: float | None, datasheet: Path | None, namespace: str | None, as_json: bool,
          **observer_site: Any) -> None:
    """
    Measure a camera by a night on a tripod: noise, errors, drift.

    Detection and time stamps, too. The Earth turns the sky by a known law: no turntable is needed.
    Images of a folder are in order of their names.
    """
    from startracker_ros.io.bags.folder import is_bag
    bag = is_bag(source)
    if camera_file is None and not bag:
        raise click.UsageError('images need --camera: startracker calibrate makes it of them')
    if bag and (epoch_year is not None or interval_s is not None):
        raise click.UsageError('a bag has its stamps: no --epoch and no --interval-s')
    _check_observer(**observer_site)
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.io.bags.errors import BagError
    from startracker_ros.io.images.camera_files import load_camera
    from startracker_ros.io.images.images import ImageError
    from startracker_ros.tools.night.night import night as measure
    from startracker_ros.tools.night.sources import NightError
    with usage_error_on(CameraError):
        camera = None if camera_file is None else load_camera(camera_file)
    with exit_1_on(NightError, BagError, ImageError):
        result = measure(source, camera, site=_observer_site(**observer_site).site,
                         start_year=epoch_year,
                         interval_s=interval_s, tracking=tracking, namespace=namespace,
                         datasheet=datasheet)
    print_result(result, as_json)
