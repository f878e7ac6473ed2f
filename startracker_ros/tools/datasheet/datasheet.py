# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The data sheet of a camera: the Monte Carlo, its rows and its page."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path
import time
from typing import Any

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.maths.rotation import random_attitude
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.output import write_output
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.datasheet import rows
from startracker_ros.tools.datasheet.bounds import limiting_magnitude, star_image
from startracker_ros.tools.datasheet.calibrated import (
    calibrated_instrument, calibration_errors, field_errors, IMAGES)
from startracker_ros.tools.datasheet.estimates import AXES
from startracker_ros.tools.datasheet.image_runs import DISTURBANCES, disturbed_runs
from startracker_ros.tools.datasheet.instrument import (
    EPOCH_YEAR, FRAME_RATE_HZ, Instrument, Pointings, START_NS)
from startracker_ros.tools.datasheet.rows import (
    lines_of, number, PUBLISHED, rates_of, SheetRow, SplitErrors)
from startracker_ros.tools.datasheet.single_images import image_errors, SHIFTS
from startracker_ros.tools.datasheet.sky_coverage import (
    field_magnitudes, identified_fields, SkyFields, star_counts)
from startracker_ros.tools.datasheet.tally import Tally
from startracker_ros.tools.datasheet.tracked_runs import RunCase, Runs, tracked_runs
from startracker_ros.tools.figures.machine import machine, StealTime
from startracker_ros.tools.parallel import Trials
from startracker_ros.tools.report.chart import page_chart
from startracker_ros.tools.report.template import render_page

RATES_DEG_S = (0.0, 0.3, 1.0, 2.0, 3.0)
LIMIT_RATES_DEG_S = (4.0, 5.0, 7.5, 10.0)
ACCELERATIONS_DEG_S2 = (0.5, 1.0, 2.0, 5.0)

LIMIT_CASES = (*(RunCase(rate, frames=20) for rate in LIMIT_RATES_DEG_S),
               *(RunCase(0.0, each, 20) for each in ACCELERATIONS_DEG_S2))

_LEAST_STARS = (4, 6, 10)


@dataclass(frozen=True)
class Effort:
    """
    How much is simulated: fields and runs for each rate, frames of a run.

    Each of the calibrations is followed through calibration_fields.
    """

    calibrations: int
    calibration_fields: int
    fields: int
    runs: int
    frames: int
    limit_runs: int
    disturbed_runs: int
    disturbed_frames: int
    sky_fields: int
    timed_frames: int


FULL = Effort(40, 100, 200, 60, 25, 6, 4, 20, 5000, 100)
QUICK = Effort(4, 50, 12, 3, 15, 1, 1, 10, 500, 20)


@dataclass(frozen=True)
class Simulated:
    """All that was simulated: for each rate, limit and disturbance, and of the whole sky."""

    errors: list[rows.SplitErrors]
    runs: list[Runs]
    limit_runs: list[Runs]
    tallies: list[Tally]
    fields: SkyFields


def simulate(instrument: Instrument, effort: Effort, seed: int, scheduler: str = '') -> Simulated:
    """Run the Monte Carlo on all cores, or on a dask cluster."""
    trials, lens, detector = Trials(), instrument.lens, instrument.detector
    # The longest first, so that the cores end together.
    for rate in reversed(RATES_DEG_S):
        trials.add(image_errors, (Instrument(lens, lens, detector), rate), effort.fields, 10,
                   seed)
    for case in reversed(cases(effort)):
        trials.add(tracked_runs, (instrument, case), effort.runs, 6, seed)
    for case in LIMIT_CASES:
        trials.add(tracked_runs, (instrument, case), effort.limit_runs, 3, seed)
    for disturbance in DISTURBANCES:
        trials.add(disturbed_runs, (instrument, disturbance, effort.disturbed_frames),
                   effort.disturbed_runs, 2, seed)
    trials.add(calibration_errors, (lens, detector, RATES_DEG_S, effort.calibration_fields),
               effort.calibrations, 2, seed)
    limit, sigma_px = faintest(detector)
    trials.add(identified_fields, (lens, limit, sigma_px), effort.sky_fields, 500, seed)
    done = trials.run(title='data sheet', scheduler=scheduler)
    images, runs = ([*islice(done, len(RATES_DEG_S))][::-1] for _ in range(2))
    limit_runs, tallies = ([*islice(done, len(each))] for each in (LIMIT_CASES, DISTURBANCES))
    calibrations, fields = done
    return Simulated([rows.SplitErrors(rate, each, calibrations[:, number])
                      for number, (rate, each) in enumerate(zip(RATES_DEG_S, images))],
                     runs, limit_runs, tallies, fields)


def cases(effort: Effort) -> list[RunCase]:
    """Return a run at each rate."""
    return [RunCase(rate, frames=effort.frames) for rate in RATES_DEG_S]


def faintest(detector: DetectorOptions) -> tuple[float, float]:
    """Return V of the faintest star found at rest, and the error in px of one a magnitude up."""
    limit = limiting_magnitude(detector, 0.0, ExtractionOptions().threshold_sigma)
    flux_e = detector.zero_flux_e_s * detector.exposure_s * 10 ** (-0.4 * (limit - 1))
    information = star_image(detector, 0.0).at(np.array([flux_e]))
    return limit, float(1 / np.sqrt(information.mean()))


def run_datasheet(lens: Camera, detector: DetectorOptions, output: Path, *, seed: int,
                  effort: Effort = FULL, scheduler: str = '') -> Result:
    """
    Simulate, write the page, and return the rows.

    CalibrationError where simulated images do not determine the camera, OSError where the page
    cannot be written, MissingLibraryError without Jinja2 or matplotlib.
    """
    begin_s, steal_time = time.perf_counter(), StealTime()
    instrument = calibrated_instrument(lens, detector, seed)
    times_ms = frame_times_ms(instrument, effort.timed_frames, seed)
    done = simulate(instrument, effort, seed, scheduler)
    limit, _ = faintest(detector)
    magnitudes = field_magnitudes(lens, limit, effort.sky_fields, seed)
    bias_rad = np.nanmean(
        field_errors(instrument, (0.0,), effort.calibration_fields, seed), axis=(0, 1))
    table = [
        *rows.split_rows(done.errors), *rows.mechanical_rows(),
        *rows.tracked_rows(cases(effort), done.runs, bias_rad),
        *rows.consistency_rows(cases(effort), done.runs, bias_rad),
        *rows.limit_rows([*cases(effort), *LIMIT_CASES], [*done.runs, *done.limit_runs],
                         bias_rad),
        *rows.acquisition_rows(done.errors, done.runs, done.fields),
        *rows.coverage_rows(magnitudes, limit), *rows.availability_rows(done.tallies),
        *rows.speed_rows(times_ms)]
    conditions = {
        **instrument.conditions, 'machine': machine(str(steal_time)),
        'calibration': f'{effort.calibrations} calibrations by {IMAGES} simulated images each; '
                       'in that of the runs, focal length '
                       f'{instrument.camera.fx - lens.fx:+.3f} px, principal point '
                       f'{instrument.camera.cx - lens.cx:+.2f}, '
                       f'{instrument.camera.cy - lens.cy:+.2f} px off the true ones',
        'rates': 'about random axes across the boresight',
        'images': f'{effort.fields} fields of {SHIFTS} images for each rate, 2 renderings each; '
                  f'{effort.runs} runs of {effort.frames} frames at {FRAME_RATE_HZ:g} Hz for '
                  f'each rate; {effort.sky_fields} star lists of random fields',
        'interval': '95 %, bootstrap over calibrations, fields or runs',
        'bound': 'Cramer-Rao bound of the noise, from all stars of the catalogue in the field',
        'published': 'Sodern Auriga, 3 sigma',
        'simulated in': f'{time.perf_counter() - begin_s:.0f} s', 'seed': seed}
    write_page(output, SheetPage(
        instrument, table, conditions, done.errors, magnitudes, done.fields, limit))
    return Result('datasheet', table, {**conditions, 'page': str(output)})


def frame_times_ms(instrument: Instrument, frames: int, seed: int) -> np.ndarray:
    """Return the wall time (N,) from image to attitude in one process, while tracking."""
    rng = np.random.default_rng(seed)
    motion = Pointings(np.array([random_attitude(rng)]), np.zeros((1, 3)))
    simulator = SkySimulator(instrument.lens, motion, camera_catalog(instrument.lens), EPOCH_YEAR,
                             detector_options=instrument.detector, seed=seed)
    pipeline, times_ms = StarTracker(instrument.camera, EPOCH_YEAR), []
    step_ns = round(1e9 / FRAME_RATE_HZ)
    for index in range(frames + 5):
        # Of one pointing, with noise of its own in each image.
        taken = simulator.frame(index * 1e-6)
        pipeline.motion.add_state(START_NS + index * step_ns, taken.state.geocentric)
        start_s = time.perf_counter()
        pipeline.process(START_NS + index * step_ns, taken.image)
        times_ms.append(1e3 * (time.perf_counter() - start_s))
    return np.array(times_ms[5:])


@dataclass(frozen=True)
class SheetPage:
    """What the page shows: rows, conditions, and the samples that are drawn."""

    instrument: Instrument
    rows: Sequence[SheetRow]
    conditions: Mapping[str, object]
    errors: Sequence[SplitErrors]
    magnitudes: list[np.ndarray]
    fields: SkyFields
    limit: float


def write_page(output: Path, sheet: SheetPage) -> None:
    """Write the page; OSError, or MissingLibraryError without Jinja2 or matplotlib."""
    lens, sections = sheet.instrument.lens, []
    for name, group in groupby(lines_of(sheet.rows), key=lambda line: line.section):
        # Those at several rates, then those without one: no empty columns.
        lines = [*group]
        tables = ([line for line in lines if None not in line.rows],
                  [line for line in lines if None in line.rows])
        sections.append((name, [(rates_of(chosen), chosen) for chosen in tables if chosen]))
    write_output(output, render_page(
        'startracker_ros.tools.datasheet', {'number': number},
        title=f'Data sheet: {np.degrees(lens.fov_x_rad):.3g} deg, {lens.width} x {lens.height} px',
        conditions=sheet.conditions,
        published_rows=[(unit.unit, unit.sigma, *map(number, (
            unit.cross_arcsec, unit.about_arcsec, unit.rate_deg_s, unit.update_hz,
            unit.acquisition_s)), unit.source) for unit in PUBLISHED],
        pictures=[*_pictures(sheet)], sections=sections))


def _pictures(sheet: SheetPage) -> Iterator[tuple[str, str]]:
    """Yield captions and pictures."""
    for axis in AXES:
        yield (f'Error of a single image {axis} over the rate, 1 sigma',
               page_chart(partial(_draw_errors, sheet=sheet, axis=axis)))
    yield (f'Stars to V {sheet.limit:.2f} in each of {len(sheet.fields.stars)} random fields over '
           'right ascension, which grows to the left from -180 deg at the right edge to 180 deg, '
           'and declination; crosses: not identified from one image',
           page_chart(partial(_draw_sky, sheet=sheet)))
    yield ('Sky with enough stars over the magnitude limit',
           page_chart(partial(_draw_coverage, sheet=sheet)))


def _draw_errors(figure: Any, sheet: SheetPage, axis: str) -> None:
    rates_deg_s = [each.rate_deg_s for each in sheet.errors]
    panel = figure.add_subplot()
    by_rate = [each.estimates(AXES[axis]) for each in sheet.errors]
    for name in by_rate[0]:
        found = [each[name] for each in by_rate]
        value, low, high = np.array([each[:3] for each in found]).T
        panel.errorbar(
            rates_deg_s, value, [np.maximum(value - low, 0), np.maximum(high - value, 0)],
            label=name, marker='o', markersize=3, capsize=2)
        if found[0].bound is not None:
            panel.plot(rates_deg_s, [each.bound for each in found], ':', color='C4',
                       label='Cramer-Rao bound of the noise')
    panel.set(xlabel='rate across the boresight [deg/s]', ylabel='error [arcsec]', yscale='log')
    # Next to the curves, not over them.
    panel.legend(loc='lower center', bbox_to_anchor=(0.5, 1), ncols=2)


def _draw_sky(figure: Any, sheet: SheetPage) -> None:
    fields = sheet.fields
    panel = figure.add_subplot(projection='mollweide')
    # Right ascension grows to the left, as on the sky.
    longitude = -((fields.ra_rad + np.pi) % (2 * np.pi) - np.pi)
    points = panel.scatter(longitude, fields.dec_rad, c=fields.stars, s=4, cmap='viridis',
                           vmax=float(np.percentile(fields.stars, 99)), rasterized=True)
    lost = ~fields.correct
    panel.plot(longitude[lost], fields.dec_rad[lost], 'rx', markersize=6)
    panel.set_xticklabels([])
    panel.set_yticks(np.radians([-60, -30, 0, 30, 60]))
    figure.colorbar(points, orientation='horizontal', shrink=0.8, label='stars in the field')


def _draw_coverage(figure: Any, sheet: SheetPage) -> None:
    panel = figure.add_subplot()
    limits = np.arange(min(3.0, sheet.limit), sheet.limit + 0.05, 0.1)
    for least in _LEAST_STARS:
        share = [100 * np.mean(star_counts(sheet.magnitudes, limit) >= least) for limit in limits]
        panel.plot(limits, share, label=f'{least} stars or more')
    panel.axvline(sheet.limit, color='grey', linestyle=':', label='limiting magnitude')
    panel.set(xlabel='faintest star, V [mag]', ylabel='share of the sky [%]')
    panel.legend(loc='lower center', bbox_to_anchor=(0.5, 1), ncols=2)
