# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two runs over the same recordings: where their attitudes differ."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.table import Result
from startracker_ros.tools.report.chart import draw_series, picture
from startracker_ros.tools.reprocess.tables import BAG, open_run, Run

_COLUMNS = [BAG, 'stamp_ns', *(f'q_{axis}' for axis in 'xyzw'),
            *(f'error_{axis}_arcsec' for axis in 'xyz')]


@dataclass(frozen=True)
class CompareRow:
    """
    One star tracker in both runs.

    A frame is that of a stamp of a bag. Differences are of frames with an attitude in both; the
    error columns are None without truth.
    """

    tracker: str
    frames_a: int
    frames_b: int
    common: int
    available_a_percent: float
    available_b_percent: float
    only_a: int
    only_b: int
    identical: int
    cross_rms_arcsec: float | None
    roll_rms_arcsec: float | None
    largest_arcsec: float | None
    error_a_arcsec: float | None
    error_b_arcsec: float | None
    first_divergent: str
    first_divergent_bag: str


def compare(folder_a: Path, folder_b: Path, drawing: Path | None = None) -> Result:
    """
    Return a row for each star tracker that both runs have, and draw the differences.

    Frames of other bags differ; the note of the result names bags of the same times.
    BagError where a folder is not a run, or nothing is common to both.
    """
    a, b = open_run(folder_a), open_run(folder_b)
    trackers = [tracker for tracker in a.trackers if tracker in b.trackers]
    if not trackers:
        raise BagError(f'{folder_a} and {folder_b} have no star tracker in common: '
                       f'{", ".join(a.trackers)} and {", ".join(b.trackers)}')
    rows, curves = [], {}
    for tracker in trackers:
        row, stamps, difference = _compare(a, b, tracker)
        rows.append(row)
        curves[tracker] = stamps, difference
    if drawing is not None:
        _draw(curves, drawing)
    remarks = [f'{name}: {found}' for name, run in (('a', a), ('b', b)) for tracker in trackers
               if (found := run.same_times(tracker))]
    remarks += [f'{row.tracker}: no frame has an attitude in both runs' for row, stamps in zip(
        rows, (stamps for stamps, _ in curves.values())) if not len(stamps)]
    return Result('compare', rows, {'a': str(folder_a), 'b': str(folder_b), **(
        {'note': '; '.join(remarks)} if remarks else {})})


def _compare(a: Run, b: Run, tracker: str) -> tuple[CompareRow, np.ndarray, np.ndarray]:
    """Return the row of a tracker, and stamps (N,) and differences (N, 3) arcsec."""
    tables = [run.table('frames', tracker, _COLUMNS) for run in (a, b)]
    quaternions = [a.vectors(table, 'q_{}', 'xyzw') for table in tables]
    known = [np.isfinite(q).all(axis=1) for q in quaternions]
    keys_a, keys_b = _frame_keys(*tables)
    _, i, j = np.intersect1d(keys_a, keys_b, return_indices=True)
    if not len(i):
        of_a, of_b = (', '.join(sorted(set(table[BAG]))) or 'nothing' for table in tables)
        raise BagError(f'{tracker}: the runs have no frame in common: one is of {of_a}, the '
                       f'other of {of_b}')
    order = np.argsort(tables[0]['stamp_ns'][i], kind='stable')
    i, j = i[order], j[order]
    stamps, bags = tables[0]['stamp_ns'][i], tables[0][BAG][i]
    in_a, in_b = known[0][i], known[1][j]
    both = in_a & in_b
    qa, qb = quaternions[0][i], quaternions[1][j]
    difference = attitude_error(qb[both], qa[both]) / ARCSEC
    same = both & (qa == qb).all(axis=1)
    # Not the rounding of a product.
    difference[same[both]] = 0.0
    divergent = np.flatnonzero((in_a != in_b) | both & ~same)
    errors = [a.vectors(table, 'error_{}_arcsec')[index]
              for table, index in zip(tables, (i, j))]
    return CompareRow(
        tracker, len(known[0]), len(known[1]), len(stamps), 100 * float(in_a.mean()),
        100 * float(in_b.mean()), int((in_a & ~in_b).sum()), int((in_b & ~in_a).sum()),
        int(same.sum()), _rms(difference[:, :2]), _rms(difference[:, 2]),
        float(np.abs(difference).max()) if len(difference) else None,
        _rms(errors[0][both][:, :2]), _rms(errors[1][both][:, :2]),
        utc(int(stamps[divergent[0]]), digits=9) if len(divergent) else '',
        str(bags[divergent[0]]) if len(divergent) else ''), stamps[both], difference


def _frame_keys(*tables: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Return for each table the numbers (N,) of its frames: of a bag and stamp the same one."""
    bags = np.unique(np.concatenate([table[BAG] for table in tables]), return_inverse=True)[1]
    stamps = np.unique(np.concatenate([table['stamp_ns'] for table in tables]),
                       return_inverse=True)[1]
    keys = bags * (len(stamps) + 1) + stamps
    return np.split(keys, [len(tables[0][BAG])])


def _rms(values: np.ndarray) -> float | None:
    """Return the root mean square of the known values of an axis, None without any."""
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values ** 2))) if len(values) else None


def _draw(curves: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    with picture(path, 3 * len(curves) + 0.5, 100) as figure:
        grid = figure.subplots(len(curves), 1, squeeze=False)
        for axes, (tracker, (stamps, difference)) in zip(grid[:, 0], curves.items()):
            draw_series(axes, stamps, difference, ('x', 'y', 'roll'), 'arcsec')
            axes.set_title(f'{tracker}: attitude of B minus that of A')
            axes.legend(loc='upper right', ncols=3)
