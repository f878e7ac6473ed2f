# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitude of four tracked stars by SNA, JPDAF and coupled, compared with the published figures.

Sadeghi, Sabahi, Saberali.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student
from startracker_evaluation.campaign.jpdaf_methods import (
    AS_PUBLISHED, Estimate, METHODS, star_neighbourhood_estimate, track, tracker_options, VARIANTS)
from startracker_evaluation.campaign.jpdaf_runs import (
    CAMERA, Cell, DETECTION_PROBABILITY, DT_S, FALSE_POINTS, FRAMES, GYRO, make_run, PUBLISHED,
    Run, STARS)
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.extras import new_figure
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, matrix_from_quaternion, quaternion_from_rotation_vector,
    rotate)
from startracker_ros.io.output import save_picture
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.rows import mean_chi_square_bounds
from startracker_ros.tools.parallel import parallel_trials

SNA, PUBLISHED_METHOD, BEYOND, COUPLED = (
    'SNA', 'as published', 'beyond', 'attitude-coupled')
ALL_METHODS = SNA, *METHODS, PUBLISHED_METHOD, BEYOND
COUPLED_RATIO = 0.4
VARIANT_CELLS = Cell('turning', 0.1, 0.02), Cell('linear', 0.1, 0.02)
"""The cells in which the variants of the association are compared."""

_PART_TRIALS = 5
_TOO_FEW = 'too few trials'
# Far more than any error of attitude (rad) and rate (rad/s): no prior knowledge.
_UNKNOWN_RAD = 0.1

Estimates = Sequence[Mapping[str, Estimate]]


@dataclass(frozen=True)
class Errors:
    """
    The errors of T runs of a cell, each by K methods.

    error (T, K, F, 3) is the attitude error about sensor axes, in arcsec; place (T, K) the mean
    square error of a star in the image, px^2, both axes; fixed (T, K) the share of frames with
    an attitude of their own; bound (T, F) the least variance of the boresight, both axes, in
    arcsec^2, NaN unless the rate is constant; square (T, K) the normalised error squared in the
    last frame, of three degrees of freedom, NaN without a covariance.
    """

    error: np.ndarray
    place: np.ndarray
    fixed: np.ndarray
    bound: np.ndarray
    square: np.ndarray

    @property
    def boresight(self) -> np.ndarray:
        """Angles (T, K, F) in arcsec between true and estimated boresight."""
        return np.hypot(self.error[..., 0], self.error[..., 1])

    @property
    def whole(self) -> np.ndarray:
        """Angles (T, K, F) in arcsec between true and estimated attitude."""
        return np.linalg.norm(self.error, axis=-1)

    def over_bound(self, method: int) -> tuple[float, float]:
        """Return the rms error of the boresight over its bound, and half its 95 % interval."""
        square = self.boresight[:, method] ** 2
        ratio, margin = ratio_of_means(square.mean(axis=1), self.bound.mean(axis=1))
        return float(np.sqrt(ratio)), float(margin / 2 / np.sqrt(ratio))


def methods_of(cell: Cell, variants: bool) -> dict[str, tuple[dict, bool]]:
    """Return the options of each filter by its name, and whether it knows the gyro."""
    if variants:
        return {name: (chosen, True) for name, chosen in VARIANTS.items()}
    return {**{name: (chosen, False) for name, chosen in METHODS.items()},
            PUBLISHED_METHOD: (AS_PUBLISHED, True), BEYOND: (METHODS[COUPLED], True)}


def errors(cell: Cell, variants: bool, trials: int, seed: int) -> Errors:
    """Return the errors of trials runs by SNA and each of methods_of()."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(trials):
        run = make_run(cell, rng)
        estimates = [star_neighbourhood_estimate(run)] + [
            track(run, tracker_options(cell, chosen), with_gyro)
            for chosen, with_gyro in methods_of(cell, variants).values()]
        error = np.stack([attitude_error(each.quaternion, run.quaternion) for each in estimates])
        rows.append((
            error / ARCSEC,
            [np.nanmean(np.sum((each.uv - run.uv) ** 2, axis=-1)) for each in estimates],
            [each.fixed.mean() for each in estimates],
            np.full(FRAMES, np.nan) if cell.jitter_deg_s else
            np.trace(cramer_rao_bound(run)[:, :2, :2], axis1=1, axis2=2) / ARCSEC ** 2,
            [last @ np.linalg.solve(each.covariance[-1], last) if len(each.covariance) else np.nan
             for last, each in zip(error[:, -1], estimates)]))
    return Errors(*(np.array(column) for column in zip(*rows)))


def ratio_of_means(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Return the ratio of the means of (T,) and half its 95 % interval, infinite for one run."""
    ratio, runs = above.mean() / below.mean(), len(above)
    if runs < 2:
        return float(ratio), np.inf
    scatter = np.std(above - ratio * below, ddof=1) / np.sqrt(runs)
    return float(ratio), float(student.ppf(0.975, runs - 1) * scatter / below.mean())


def at_most(value: float, margin: float, most: float) -> bool | None:
    """Return whether a figure is at most a bound, None where the bound is within the margin."""
    return None if abs(value - most) < margin else value <= most


def cramer_rao_bound(run: Run) -> np.ndarray:
    """
    Return the posterior Cramer-Rao bound (F, 3, 3) rad^2 of the attitude error.

    The rate is constant and unknown at the start: the recursion of Tichavsky, Muravchik and
    Nehorai (IEEE Trans. Signal Process. 46, 1998) without process noise. The association of
    centroids and stars is known.
    """
    inverse = np.eye(6) * _UNKNOWN_RAD ** 2
    bound = []
    for k, (q, rate, seen) in enumerate(zip(run.quaternion, run.rate_rad_s, run.seen)):
        if k:
            step = np.eye(6)
            step[:3, :3] = matrix_from_quaternion(quaternion_from_rotation_vector(-rate * DT_S))
            step[:3, 3:] = DT_S * np.eye(3)
            inverse = step @ inverse @ step.T
        jacobian = image_jacobian(CAMERA, rotate(conjugate(q), run.icrf[seen >= 0]))
        information = np.linalg.inv(inverse)
        information[:3, :3] += np.einsum('nki,nkj->ij', jacobian, jacobian) / (
            run.cell.variance_px2)
        inverse = np.linalg.inv(information)
        bound.append(inverse[:3, :3])
    return np.stack(bound)


@dataclass(frozen=True)
class MethodRow:
    """
    A figure of a method; ratios are to SNA, whole is the error of the whole attitude.

    as_published is the figure of the method of the paper, whose jitter is measured, and beyond
    that of the filter of one attitude for all stars, with the same rates. holds is of both, None
    without a bound and with too few trials for it.
    """

    case: str
    paper: float | None = None
    as_published: float | None = None
    beyond: float | None = None
    ours: float | None = None
    unit: str = ''
    ratio: float | None = None
    paper_ratio: float | None = None
    whole: float | None = None
    whole_ratio: float | None = None
    bound: str = ''
    holds: bool | None = None

    @classmethod
    def judged(cls, case: str, bound: str, checks: list[bool | None], **figures: Any
               ) -> 'MethodRow':
        """Return a row that holds if all checks do; unknown ones are named."""
        known = [check for check in checks if check is not None]
        if len(known) < len(checks) and all(known):
            return cls(case, bound=f'{bound}: {_TOO_FEW}', holds=None, **figures)
        return cls(case, bound=bound, holds=all(known), **figures)


def comparison_rows(cell: Cell, found: Errors) -> Iterator[MethodRow]:
    """Yield the errors over those of SNA, of boresight and whole angle, and those of the stars."""
    sna, jpdaf = PUBLISHED[cell]
    most = jpdaf / sna
    columns = ALL_METHODS.index(PUBLISHED_METHOD), ALL_METHODS.index(BEYOND)
    for name, angle in (('boresight', found.boresight), ('whole angle', found.whole)):
        run = angle.mean(axis=2)
        ratios = [ratio_of_means(run[:, k], run[:, 0]) for k in columns]
        yield MethodRow.judged(
            f'{cell}: {name}, over SNA', f'both <= {most:.3f}',
            [at_most(*ratio, most) for ratio in ratios],
            paper=most, as_published=ratios[0][0], beyond=ratios[1][0])
    places = [ratio_of_means(found.place[:, k], found.place[:, 0]) for k in columns]
    yield MethodRow.judged(
        f'{cell}: mean square position error', 'both <= SNA',
        [at_most(*place, 1.0) for place in places], unit='px^2', ours=found.place[:, 0].mean(),
        as_published=found.place[:, columns[0]].mean(), beyond=found.place[:, columns[1]].mean())


def cell_rows(cell: Cell, found: Errors) -> Iterator[MethodRow]:
    """Yield a row for SNA and each filter that does not know the jitter."""
    sna, jpdaf = PUBLISHED[cell]
    most = jpdaf / sna
    boresight, whole = found.boresight.mean(axis=2), found.whole.mean(axis=2)
    ours, margin = ratio_of_means(boresight[:, 0], np.full(len(boresight), sna))
    yield MethodRow.judged(
        f'{cell}: SNA', 'boresight 0.9 .. 1.1 of the paper', [at_most(abs(ours - 1), margin, 0.1)],
        ours=boresight[:, 0].mean(), paper=sna, unit='arcsec', whole=whole[:, 0].mean())
    for k, method in enumerate(METHODS, 1):
        ratio = ratio_of_means(boresight[:, k], boresight[:, 0])
        whole_ratio = ratio_of_means(whole[:, k], whole[:, 0])
        checks = [at_most(*ratio, most), at_most(*whole_ratio, most)]
        bound = f'both ratios <= {most:.3f}'
        if cell.jitter_deg_s:
            states = ', '.join(f'{name} {_state(check)}' for name, check in zip(
                ('boresight', 'whole angle'), checks))
            bound, checks = f'{most:.3f}, of measured jitter: {states}', []
        if method == COUPLED:
            bound = f'boresight ratio <= {COUPLED_RATIO}; {bound}'
            checks = [*checks, at_most(*ratio, COUPLED_RATIO)]
        figures = {'ours': boresight[:, k].mean(), 'paper': jpdaf, 'unit': 'arcsec',
                   'ratio': ratio[0], 'paper_ratio': most, 'whole': whole[:, k].mean(),
                   'whole_ratio': whole_ratio[0]}
        case = f'{cell}: {method}{", jitter unknown" if cell.jitter_deg_s else ""}'
        yield (MethodRow.judged(case, bound, checks, **figures) if checks
               else MethodRow(case, bound=bound, **figures))


def _state(check: bool | None) -> str:
    return f'with {_TOO_FEW}' if check is None else 'met' if check else 'missed'


def constant_rate_rows(cell: Cell, found: Errors) -> Iterator[MethodRow]:
    """Yield the rows of a cell with a constant rate, the model of the coupled filter."""
    for k, method in enumerate(ALL_METHODS[:-1]):
        ours, margin = found.over_bound(k)
        case = f'{cell}: {method} over the Cramer-Rao bound'
        yield (MethodRow.judged(case, '<= 1.1', [at_most(ours, margin, 1.1)], ours=ours)
               if method == COUPLED else MethodRow(case, ours=ours))
    for method in (PUBLISHED_METHOD, COUPLED):
        yield consistency_row(f'{cell}: normalised error squared, {method}',
                              found.square[:, ALL_METHODS.index(method)], method == COUPLED)


def consistency_row(case: str, squares: np.ndarray, two_sided: bool) -> MethodRow:
    """
    Return the mean of normalised errors squared (T,) over their three degrees of freedom.

    One bound alone is for a covariance that is larger than it has to be.
    """
    low, high = (bound / 3 for bound in mean_chi_square_bounds(3, len(squares)))
    ours = float(squares.mean() / 3)
    holds = ours <= high and (ours >= low or not two_sided)
    # Bounds that are this far apart say little.
    known = high - low < 1 or not holds
    return MethodRow.judged(case, f'{low:.3f} .. {high:.3f}' if two_sided else f'<= {high:.3f}',
                            [holds if known else None], ours=ours)


def variant_rows(cell: Cell, found: Errors) -> Iterator[MethodRow]:
    """Yield the ratios of each variant of the association, with the jitter measured."""
    sna, jpdaf = PUBLISHED[cell]
    boresight, whole = found.boresight.mean(axis=2), found.whole.mean(axis=2)
    for k, name in enumerate(VARIANTS, 1):
        ratios = [ratio_of_means(angle[:, k], angle[:, 0]) for angle in (boresight, whole)]
        fixed = 100 * found.fixed[:, k].mean()
        yield MethodRow.judged(
            f'{cell}: {name}: {fixed:.2f} % of the frames', f'both ratios <= {jpdaf / sna:.3f}',
            [at_most(*ratio, jpdaf / sna) for ratio in ratios], ours=boresight[:, k].mean(),
            paper=jpdaf, unit='arcsec', ratio=ratios[0][0], paper_ratio=jpdaf / sna,
            whole=whole[:, k].mean(), whole_ratio=ratios[1][0])


def run_jpdaf_campaign(*, trials: int, seed: int, scheduler: str = '',
                       output: Path | None = None) -> Result:
    """Run every cell; with an output folder the figures of the paper are drawn there."""
    cases = [(cell, False) for cell in PUBLISHED] + [(cell, True) for cell in VARIANT_CELLS]
    done = parallel_trials(errors, cases, trials, _PART_TRIALS, seed, title='jpdaf',
                           scheduler=scheduler)
    found = dict(zip(PUBLISHED, done))
    rows = [row for cell in PUBLISHED for row in comparison_rows(cell, found[cell])]
    rows += [row for cell in PUBLISHED for row in cell_rows(cell, found[cell])]
    for cell in PUBLISHED:
        if not cell.jitter_deg_s:
            rows += constant_rate_rows(cell, found[cell])
    for cell, variants in zip(VARIANT_CELLS, done[len(PUBLISHED):]):
        rows += variant_rows(cell, variants)
    if output is not None:
        draw_errors({cell: dict(zip(ALL_METHODS, each.boresight.mean(axis=0)))
                     for cell, each in found.items()}, output)
        rng = np.random.default_rng(seed)
        runs = [make_run(Cell(motion, 0.5, 0.02), rng) for motion in ('linear', 'turning')]
        estimates = [{SNA: star_neighbourhood_estimate(run), 'JPDAF': track(
            run, tracker_options(run.cell, AS_PUBLISHED), with_gyro=True)} for run in runs]
        draw_tracks(runs, estimates, output)
        draw_run(runs, estimates, output)
    return Result('campaign jpdaf', rows, _conditions(trials, seed))


def _conditions(trials: int, seed: int) -> dict[str, object]:
    return {
        'camera': f'{CAMERA.width} x {CAMERA.height} px, 12 x 12 deg: '
                  f'{CAMERA.pixel_rad / ARCSEC:.1f} arcsec a pixel',
        'error': 'angle between true and estimated boresight, mean over frames and runs. The '
                 'paper gives neither the camera nor the angle: all its SNA figures are 46 to 48 '
                 'arcsec times sigma in px, which is what TRIAD of the two stars farthest apart '
                 'makes of the boresight with this camera. The whole angle, in whole, is mostly '
                 'roll and follows from the pixel count alone: it would take 6000 px across',
        'stars': 'the four brightest to V 6.5 that stay in the image and have no close neighbour, '
                 'anywhere in the orbit; identified in the first frames',
        'orbit': '700 km, 30 deg, 90 minutes as in the paper (Kepler: 98.8). turning: boresight '
                 'along the orbit normal; linear: to the zenith',
        'frames': f'{FRAMES} at {1 / DT_S:g} Hz, {FALSE_POINTS} false points in each on average, '
                  f'uniform; a star is missing in {100 * (1 - DETECTION_PROBABILITY):.2g} %',
        'jitter': 'roll rate uniform either way, constant over ten frames',
        'SNA': 'with the true body rate, which no other method knows; TRIAD of the measured '
               'positions, of three stars or more. Of the position error it is ours',
        'as published': 'star_tracker with config/paper_jpdaf.yaml: confirmation by SNA, JPDAF '
                        'with phi! / V^phi, TRIAD, the roll measured by a gyro of '
                        f'{GYRO.gyro_noise_deg_sqrt_h:g} deg/sqrt(h); coordinated_turn for '
                        'turning',
        'JPDAF': 'star_tracker with default association, without a gyro. Process noise of all '
                 'filters by one rule: the velocity change that the motion makes beyond the '
                 'model (curve of the path, unknown changes of the roll rate, Coriolis and '
                 'centrifugal acceleration), as a random walk',
        'attitude-coupled': "star_tracker's model attitude, without a gyro; beyond: with it",
        'Cramer-Rao bound': 'posterior, rms of the boresight, of a constant rate unknown at the '
                            'start',
        'normalised error squared': 'of the attitude of the last frame, over its three degrees of '
                                    'freedom, with 95 % chi-square bounds',
        'holds': f'{_TOO_FEW}: the bound is within the 95 % interval of the figure',
        'trials': trials, 'seed': seed}


def draw_errors(found: Mapping[Cell, Mapping[str, np.ndarray]], folder: Path) -> Path:
    """Draw errors (F,) over the frames, mean of all runs, by method, at 0.02 px^2."""
    figure = new_figure(figsize=(12, 6))
    cells = [cell for cell in found if cell.variance_px2 == 0.02]
    for axis, cell in zip(figure.subplots(2, len(cells) // 2, sharex=True, sharey=True).flat,
                          cells):
        # It covers another one.
        *_, last = found[cell]
        for method, error in found[cell].items():
            axis.plot(np.arange(FRAMES), error, '--' if method == last else '-', linewidth=1,
                      label=method)
        axis.set_title(str(cell))
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    figure.supxlabel('frame')
    figure.supylabel('boresight error, arcsec')
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc='upper center',
                  ncols=len(found[cells[0]]))
    figure.get_layout_engine().set(rect=(0, 0, 1, 0.94))  # below the legend
    return save_picture(figure, folder / 'jpdaf.png')


def draw_tracks(runs: Sequence[Run], estimates: Estimates, folder: Path) -> Path:
    """Draw the path of a star under jitter (figure 2) and all tracks (figures 5 and 6)."""
    figure = new_figure(figsize=(12, 4.5))
    axes = figure.subplots(1, 1 + len(runs))
    measured = [frame[index] for frame, index in zip(runs[0].centroids, runs[0].seen[:, 0])
                if index >= 0]
    axes[0].plot(*np.array(measured).T, '.', color='tab:grey', markersize=3, label='measured')
    axes[0].plot(*runs[0].uv[:, 0].T, linewidth=1, label='true')
    axes[0].set_title(f'2: a star under jitter, {FRAMES} frames')
    axes[0].legend()
    for axis, number, run, each in zip(axes[1:], (5, 6), runs, estimates):
        # In 400 frames a turning image moves its stars by some pixels only.
        times = {'linear': 1, 'turning': 10}[run.cell.motion]
        for star in range(STARS):
            start = run.uv[0, star]
            seen, true = (start + times * (uv[:, star] - start)
                          for uv in (each['JPDAF'].uv, run.uv))
            axis.plot(*seen.T, '.', markersize=2)
            axis.plot(*true.T, color='black', linewidth=0.5)
        axis.set_title(f'{number}: four stars, {run.cell.motion}'
                       + f', motion times {times}' * (times > 1))
    for axis in axes:
        axis.set(xlabel='u, px', ylabel='v, px')
        axis.invert_yaxis()
        axis.grid(alpha=0.3)
    return save_picture(figure, folder / 'jpdaf_tracks.png')


def draw_run(runs: Sequence[Run], estimates: Estimates, folder: Path) -> Path:
    """Draw the errors of attitude (figures 7, 8) and of a star (9, 10) over the frames."""
    figure = new_figure(figsize=(12, 7))
    axes = figure.subplots(2, len(runs), sharex=True)
    for column, (run, each) in enumerate(zip(runs, estimates)):
        for name, estimate in each.items():
            error = np.hypot(*attitude_error(estimate.quaternion, run.quaternion).T[:2])
            distance = np.linalg.norm(estimate.uv[:, 0] - run.uv[:, 0], axis=1)
            time_s = np.arange(FRAMES) * DT_S
            axes[0, column].plot(time_s, error / ARCSEC, linewidth=1, label=name)
            axes[1, column].plot(time_s, distance, linewidth=1, label=name)
        axes[0, column].set_title(f'{7 + column}: boresight error, arcsec: {run.cell}')
        axes[1, column].set_title(f'{9 + column}: distance of a star from the truth, px')
        axes[1, column].set_xlabel('s')
    for axis in axes.flat:
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend()
    return save_picture(figure, folder / 'jpdaf_run.png')
