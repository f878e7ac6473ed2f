# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps of mounts and focal lengths found in long flights, and false ones in clean months."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, conjugate, matrix_from_quaternion, multiply
from startracker_ros.io.table import Result
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.sim.flights.truth import Truth
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.reprocess.frame_fit import fit_frame, Stars
from startracker_ros.tools.reprocess.tables import LENS_BIN_S
from startracker_ros.tools.trend.series import Series
from startracker_ros.tools.trend.steps import find_steps
from startracker_ros.tools.trend.trend import drift_rows, trend_page

CASES = ('mount', 'focal', 'clean')
MOUNT_STEP_ARCSEC, FOCAL_STEP_PERCENT = 1.0, 0.01
CLEAN_DAYS, FLIGHT_DAYS = 300.0, 2.0
LEAST_FOUND, PAGE_MB = 0.99, 5.0
_PHASES = 360


@dataclass(frozen=True)
class _Geometry:
    """
    What the stars of one frame determine at _PHASES of the orbit.

    turn (P, 3, 3) is the Cholesky factor of the covariance of the attitude in rad^2, focal (P,)
    the 1 sigma of the focal ratio.
    """

    turn: np.ndarray
    focal: np.ndarray


def run_trend_bench(*, trials: int, seed: int, only: Sequence[str] = CASES) -> Result:
    """Search trials flights of two days with one step each, and ten months without."""
    # Nothing but the step changes from flight to flight.
    flight, rows = _Flight(FlightOptions()), list[Row]()
    for number, (kind, size, unit) in enumerate((
            ('mount', MOUNT_STEP_ARCSEC, 'arcsec'), ('focal', FOCAL_STEP_PERCENT, '%'))):
        if kind in only:
            rows += _step_rows(flight, number, kind, size, unit, trials, seed)
    if 'clean' in only:
        rows += _clean_rows(flight, seed)
    return Result('bench trend', rows, {
        'flight': 'two heads of 12 deg at 1 Hz, mounts and focal lengths that drift and change '
                  'with the orbit', 'bins': 'simulated, with the errors that their stars give',
        'seed': seed, 'machine': machine()})


def _step_rows(flight: '_Flight', number: int, kind: str, size: float, unit: str, trials: int,
               seed: int) -> list[Row]:
    """Return how many steps at random dates are found, and how well."""
    found, other, late_s, errors, least = 0, 0, [0.0], list[float](), 0.0
    for trial in range(trials):
        rng = np.random.default_rng([seed, number, trial])
        day = rng.uniform(0.25, 0.75) * FLIGHT_DAYS
        options = FlightOptions(days=FLIGHT_DAYS, mount_step_day=day, focal_step_day=day,
                                mount_step_arcsec=size if kind == 'mount' else 0.0,
                                focal_step_percent=size if kind == 'focal' else 0.0)
        series = flight.series(options, rng)[kind == 'mount']
        search = find_steps(series.stamp_ns, series.values, flight.orbit_s)
        apart_s = [abs(step.stamp_ns * 1e-9 - options.start_utc_s - day * 86400)
                   for step in search.steps]
        near = [step for step, apart in zip(search.steps, apart_s) if apart <= flight.orbit_s]
        found += bool(near)
        other += len(search.steps) - bool(near)
        if near:
            late_s.append(min(apart_s))
            errors.append(float(near[0].size[0]) - size)
        least = max(least, float(search.least[0]))
    share = found / trials
    return [
        Row(f'{kind} step of {size:g} {unit}: found and dated within an orbit', share, '1',
            least=LEAST_FOUND),
        Row(f'{kind}: other steps', other, 'steps', '0', other == 0),
        Row(f'{kind}: date, largest error', max(late_s) / 60, 'min'),
        Row(f'{kind}: size, rms error', float(np.sqrt(np.mean(np.square(errors)))), unit),
        Row(f'{kind}: smallest step that is found', least, unit)]


def _clean_rows(flight: '_Flight', seed: int) -> list[Row]:
    """Return the steps that are found in ten months without, and the size of their page."""
    options = FlightOptions(days=CLEAN_DAYS)
    both = flight.series(options, np.random.default_rng([seed, 9]))
    searches = [(series, find_steps(series.stamp_ns, series.values, flight.orbit_s))
                for series in both]
    steps = sum(len(search.steps) for _, search in searches)
    rows = [row for series, search in searches for row in drift_rows(series, search)]
    page_mb = len(trend_page('ten months', searches, rows, (), (), ()).encode()) / 1e6
    return [Row(f'{CLEAN_DAYS:g} days without a step: steps', steps, 'steps', '0', steps == 0),
            Row(f'page of {CLEAN_DAYS * 86400 * 2 / 1e6:.0f} million frames', page_mb, 'MB',
                most=PAGE_MB)]


class _Flight:
    """
    Bins of a minute as trend makes them, with the errors of all their frames averaged.

    The same stars come into view in each orbit: their geometry is computed once.
    """

    def __init__(self, options: FlightOptions) -> None:
        self._truth = Truth(options, 0)
        self._orbit_s = 2 * np.pi / self._truth.orbit.rate_rad_s
        year = epoch_year_from_stamp(int(options.start_utc_s * 1e9))
        onboard = onboard_catalog(load_catalog(), self._truth.camera, year,
                                  options.magnitude_limit)
        self._heads = [_geometry(self._truth, onboard, head, self._orbit_s) for head in range(2)]

    @property
    def orbit_s(self) -> float:
        """The period."""
        return self._orbit_s

    def series(self, options: FlightOptions, rng: np.random.Generator) -> tuple[Series, Series]:
        """Return the focal length of head_1 and the mount of head_2 in a flight."""
        truth = Truth(options, 0)
        time_s = np.arange(LENS_BIN_S / 2, options.days * 86400, LENS_BIN_S)
        phase = (time_s / self._orbit_s % 1 * _PHASES).astype(int)
        mean = np.sqrt(options.rate_hz * LENS_BIN_S * (1 - options.missing))
        errors = [np.einsum('nij,nj->ni', head.turn[phase], rng.standard_normal(
            (len(time_s), 3))) / mean for head in self._heads]
        relative = matrix_from_quaternion(multiply(
            conjugate(truth.attitude(1, time_s)), truth.attitude(0, time_s)))
        mount = (truth.mount_rad(1, time_s) + errors[1]
                 - np.einsum('nij,nj->ni', relative, errors[0]))
        focal = (truth.focal_ratio(0, time_s) - 1
                 + self._heads[0].focal[phase] * rng.standard_normal(len(time_s)) / mean)
        stamps = truth.stamps_ns(time_s)
        return (Series('head_1 focal length', '%', ('focal',), stamps, 100 * focal[:, None]),
                Series('head_1 to head_2 mount', 'arcsec', ('x', 'y', 'z'), stamps,
                       mount / ARCSEC))


def _geometry(truth: Truth, onboard: OnboardCatalog, head: int, orbit_s: float) -> _Geometry:
    camera, options = truth.camera, truth.options
    turns, focal = [], []
    for quaternion in truth.attitude(head, (np.arange(_PHASES) + 0.5) / _PHASES * orbit_s):
        matrix = matrix_from_quaternion(quaternion)
        star = onboard.within(matrix[:, 2], camera.corner_angle_rad)
        uv = camera.project(onboard.direction[star] @ matrix)
        star, uv = star[camera.contains(uv)], uv[camera.contains(uv)]
        magnitude = onboard.magnitude[star]
        sigma = options.centroid_sigma_px(magnitude)
        fit = fit_frame(camera, quaternion, Stars(
            onboard.direction[star], uv, sigma, magnitude),
            uv, sigma, np.ones(len(uv)))
        assert fit is not None, 'a field of less than four stars'
        turns.append(np.linalg.cholesky(fit.covariance))
        focal.append(1 / np.sqrt(fit.lens[0]))
    return _Geometry(np.array(turns), np.array(focal))
