# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude solvers compared with SciPy on the same directions: time, error, true covariance."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rich.progress import track as progress
import scipy
from scipy.spatial.transform import Rotation
from startracker_ros.core.attitude.estimate import (
    AttitudeEstimate, cramer_rao, estimate_attitude, SOLVERS)
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, random_attitude)
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.correctness import nees_of
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import BenchRow, mean_chi_square_bounds
from startracker_ros.tools.figures.timing import cpu_timed, garbage_collector_off

VECTORS = (4, 20, 40)
FOV_DEG = 12.0
SIGMA_ARCSEC = (5.0, 20.0)
PEER = 'align_vectors'
OPTIMAL = tuple(name for name in SOLVERS if name != 'triad')
_BUDGET_US = 25.0  # of one attitude from _BUDGET_VECTORS vectors
_BUDGET_VECTORS = 20
_AGREEMENT_RAD = 1e-10
_CALLS = 20  # timed together: the resolution of the CPU clock is coarse


@dataclass(frozen=True)
class Draw:
    """Measured directions (N, 3) to known stars (N, 3), their sigma (N,) and the truth."""

    sensor: np.ndarray
    icrf: np.ndarray
    sigma_rad: np.ndarray
    quaternion: np.ndarray
    bound: np.ndarray


def draw(count: int, rng: np.random.Generator) -> Draw:
    """Return stars all over a square field; the bound is that of the true directions."""
    half = np.tan(np.radians(FOV_DEG) / 2)
    true = _unit(np.column_stack([rng.uniform(-half, half, (count, 2)), np.ones(count)]))
    sigma_rad = rng.uniform(*SIGMA_ARCSEC, count) * ARCSEC
    noise = rng.normal(0, 1, (count, 3)) * sigma_rad[:, None]
    across = noise - true * np.sum(noise * true, 1, keepdims=True)
    quaternion = random_attitude(rng)
    return Draw(_unit(true + across), true @ matrix_from_quaternion(quaternion).T, sigma_rad,
                quaternion, cramer_rao(true, sigma_rad))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def ours(solver: str) -> Callable[[Draw], AttitudeEstimate]:
    """Return the call that is timed: quaternion, covariance, residuals and chi2."""
    return lambda seen: estimate_attitude(seen.sensor, seen.icrf, seen.sigma_rad, solver)


def peer(seen: Draw) -> tuple[Rotation, float]:
    """Return the rotation and the residual of SciPy, which has no covariance."""
    return Rotation.align_vectors(seen.icrf, seen.sensor, weights=1 / seen.sigma_rad ** 2)


def times_us(draws: Sequence[Draw]) -> dict[str, float]:
    """Return the median process CPU time of a call of each, in turn over the same draws."""
    calls = {**{name: ours(name) for name in SOLVERS}, PEER: peer}
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call(draws[0])
    with garbage_collector_off():
        for begin in range(0, len(draws), _CALLS):
            some = draws[begin:begin + _CALLS]
            for name, call in calls.items():
                spent[name].append(cpu_timed(_call_with_all, call, some)[0] / len(some))
    return {name: 1e6 * float(np.median(each)) for name, each in spent.items()}


def _call_with_all(call: Callable[[Draw], object], draws: Sequence[Draw]) -> None:
    for seen in draws:
        call(seen)


@dataclass(frozen=True)
class Errors:
    """Of one solver: errors (T, 3) over the bound of each axis, NEES (T,), quaternions (T, 4)."""

    over_bound: np.ndarray
    nees: np.ndarray
    quaternion: np.ndarray

    @property
    def cross_boresight(self) -> float:
        """Root mean square of x and y over the bound."""
        return float(np.sqrt(np.mean(self.over_bound[:, :2] ** 2)))

    @property
    def roll(self) -> float:
        """Root mean square of z over the bound."""
        return float(np.sqrt(np.mean(self.over_bound[:, 2] ** 2)))


def errors(draws: Sequence[Draw], found: Sequence[tuple[np.ndarray, np.ndarray]]) -> Errors:
    """Compare quaternions and covariances with the truth."""
    quaternion = np.array([each for each, _ in found])
    error = attitude_error(quaternion, np.array([seen.quaternion for seen in draws]))
    sigma = np.sqrt([np.diag(seen.bound) for seen in draws])
    nees = nees_of(error, np.array([covariance for _, covariance in found]))
    return Errors(error / sigma, nees, quaternion)


def measure(draws: Sequence[Draw]) -> dict[str, Errors]:
    """Return the errors of each solver and, by the bound, of the peer."""
    figures = {}
    for name in SOLVERS:
        found = [ours(name)(seen) for seen in draws]
        figures[name] = errors(draws, [(each.quaternion, each.covariance_sensor)
                                       for each in found])
    figures[PEER] = errors(draws, [(peer(seen)[0].as_quat(), seen.bound) for seen in draws])
    return figures


def _beside_peer(case: str, ours: float, unit: str, peer: float, bound: str, holds: bool
                 ) -> BenchRow:
    return BenchRow(case, ours, unit, f'{PEER} {peer:.3g}', ours / peer, bound, holds)


def time_rows(count: int, median_us: dict[str, float]) -> Iterator[BenchRow]:
    """Yield the time of each solver."""
    for name in SOLVERS:
        limit_us = _BUDGET_US if count == _BUDGET_VECTORS else median_us[PEER]
        yield _beside_peer(f'{count} vectors: {name}, time of a call', median_us[name], 'us',
                           median_us[PEER], f'<= {limit_us:.3g}', median_us[name] <= limit_us)


def error_rows(count: int, figures: dict[str, Errors]) -> Iterator[BenchRow]:
    """Yield the errors of each solver, and how well the optimal ones agree."""
    draws = len(figures[PEER].nees)
    for name in SOLVERS:
        for axis, squares in (('cross_boresight', 2 * draws), ('roll', draws)):
            value = getattr(figures[name], axis)
            # Two stars alone cannot reach the bound of all.
            limit = np.sqrt(gate(1e-3, squares) / squares) if name in OPTIMAL else np.inf
            yield _beside_peer(
                f'{count} vectors: {name}, {axis.replace("_", "-")} error over the bound',
                value, '', getattr(figures[PEER], axis),
                f'<= {limit:.3f}' if name in OPTIMAL else '', value <= limit)
    apart = max(np.linalg.norm(attitude_error(
        figures[name].quaternion, figures[OPTIMAL[0]].quaternion), axis=1).max()
        for name in OPTIMAL[1:])
    yield BenchRow(f'{count} vectors: {", ".join(OPTIMAL)}, largest angle between them',
                   float(apart), 'rad', most=_AGREEMENT_RAD)


def consistency_rows(figures: Sequence[dict[str, Errors]]) -> Iterator[BenchRow]:
    """Yield the mean normalised error squared of each solver over all draws; 3 is right."""
    for name in SOLVERS:
        nees = np.concatenate([each[name].nees for each in figures])
        low, high = mean_chi_square_bounds(3, len(nees))
        yield BenchRow(f'all: {name}, normalised error squared', nees.mean(), '',
                       bound=f'{low:.3f} .. {high:.3f}', holds=low <= nees.mean() <= high)


def run_attitude_bench(*, trials: int, seed: int, vectors: Sequence[int] = VECTORS) -> Result:
    """Run all solvers and the peer on the same draws of each number of vectors."""
    table: list[BenchRow] = []
    figures = []
    for count in progress(vectors, 'attitude', transient=True):
        rng = np.random.default_rng((seed, count))
        draws = [draw(count, rng) for _ in range(trials)]
        table += time_rows(count, times_us(draws))
        figures.append(measure(draws))
        table += error_rows(count, figures[-1])
    table += consistency_rows(figures)
    return Result('bench attitude', table, {
        'machine': machine(f'SciPy {scipy.__version__}'),
        'vectors': f'all over a square field of {FOV_DEG:g} deg, random attitudes; sigma of each '
                   f'{SIGMA_ARCSEC[0]:g} to {SIGMA_ARCSEC[1]:g} arcsec, known to the solvers',
        'error over the bound': 'root mean square, each error over the Cramer-Rao bound of its '
                                'draw and axis; 0.1 % of runs exceed the limit by chance',
        'normalised error squared': '95 % chi-square bounds of the mean over all draws',
        'times': f'process CPU time of a call, one thread, median over {_CALLS} calls at a time, '
                 f'in turn; ours with covariance, residuals and chi2, {PEER} without covariance',
        'trials': trials, 'seed': seed})
