# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of a run: what a segment collects, and Parquet files by day and tracker."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.export.tables import load_parquet_writer
from startracker_ros.tools.figures.correctness import nees_of
from startracker_ros.tools.reprocess.frame_fit import FrameFit

# --- widths of star images, from the scatter of their centroids ---

GRID = 8
"""Cells of the map on each axis of the image."""

WIDTH_DTYPE = np.dtype([('stamp_ns', 'i8'), ('column', 'i2'), ('row', 'i2'), ('count', 'i4'),
                        ('square_px2', 'f8')])
"""Sums over a segment for each cell of the image: stars, and s^2 of width_px()."""

_ATTITUDE = 3
"""What the fit of a frame removes from the residuals of its stars."""


class FittedStars(NamedTuple):
    """The stars (K,) of a frame's fit: hip, uv (K, 2) px and SNR."""

    hip: np.ndarray
    uv: np.ndarray
    snr: np.ndarray


NO_STARS = FittedStars(np.empty(0, np.int32), np.empty((0, 2)), np.empty(0))


def width_rows(frames: Sequence[tuple[FittedStars, FrameFit]], camera: Camera, begin_ns: int
               ) -> np.ndarray:
    """
    Return the table widths of a segment.

    A Gaussian image of width s (1 sigma), in the noise of the background, has centroids of error
    sqrt(2) s / SNR per axis. Clouds do not hold the width that was fitted, so s^2 is the mean of
    (residual SNR)^2 / 2 on an axis. A residual of FrameFit contains the errors of the others: the
    variance of K stars is too large by 1 / (1 - 3 / (2 K)) on average.
    """
    if not frames:
        return np.empty(0, WIDTH_DTYPE)
    count = [len(stars.hip) for stars, _ in frames]
    own = np.repeat([1 - _ATTITUDE / (2 * stars) for stars in count], count)
    residual_px = np.concatenate([fit.residual for _, fit in frames]) / camera.pixel_rad
    snr = np.concatenate([stars.snr for stars, _ in frames])
    square = own * (residual_px ** 2).mean(axis=1) * snr ** 2 / 2
    cells = (np.concatenate([stars.uv for stars, _ in frames]) + 0.5) * GRID / [
        camera.width, camera.height]
    column, row = np.clip(cells.astype(int), 0, GRID - 1).T
    known = np.isfinite(square)
    cell = (row * GRID + column)[known]
    stars = np.bincount(cell, minlength=GRID ** 2)
    rows = np.zeros(np.count_nonzero(stars), WIDTH_DTYPE)
    rows['row'], rows['column'] = np.divmod(np.flatnonzero(stars), GRID)
    rows['stamp_ns'], rows['count'] = begin_ns, stars[stars > 0]
    rows['square_px2'] = np.bincount(cell, square[known], GRID ** 2)[stars > 0]
    return rows


def width_px(square_px2: float, count: int) -> tuple[float, float]:
    """Return the width of sums over stars and its 1 sigma, NaN of none."""
    if not count:
        return math.nan, math.nan
    width = math.sqrt(square_px2 / count)
    return width, width / (2 * math.sqrt(count))


# --- tables ---

STATES = ('LOST', 'ACQUIRING', 'TRACKING')
PAIRS = ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')
UPPER = np.triu_indices(3)
LENS_BIN_S = 60.0
BAG = 'bag'
SUMMARY = 'summary.json'
_DAY_NS = 86_400 * 10 ** 9

FRAME_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), ('state', 'i1'), ('stars', 'i2'), ('residual_px', 'f4'),
    *((f'q_{axis}', 'f8') for axis in 'xyzw'),
    *((f'cov_{pair}_rad2', 'f4') for pair in PAIRS),
    *((f'rate_{axis}_rad_s', 'f8') for axis in 'xyz'),
    *((f'single_{axis}_arcsec', 'f4') for axis in 'xyz'),
    *((f'single_cov_{pair}_arcsec2', 'f4') for pair in PAIRS),
    ('zero_point_mag', 'f4'), *((f'error_{axis}_arcsec', 'f4') for axis in 'xyz'),
    *((f'protection_{axis}_rad', 'f4') for axis in 'xyz')])
"""One row for each frame; single is the turn from the tracked attitude to that of the frame's
stars alone, error that from the truth to the attitude, protection its bound, infinite where there
is none. Unknown values are NaN."""

LENS_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), ('frames', 'i4'), ('ff', 'f8'), ('fk', 'f8'), ('kk', 'f8'), ('f', 'f8'),
    ('k', 'f8')])
"""Normal equations of changes of focal ratio f and of k1, summed over a minute of frames."""

STAR_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), ('hip', 'i4'), ('magnitude', 'f4'), ('count', 'i4'), ('weight', 'f8'),
    ('east', 'f8'), ('north', 'f8'), ('chi2', 'f8'), ('difference_mag', 'f8'),
    ('square_mag2', 'f8')])
"""Sums over a segment for each star, weighted by 1 / sigma^2 in arcsec^-2: residuals to east and
north in arcsec, their squares over sigma^2, and of magnitude minus catalogue."""


class _Frame(NamedTuple):
    """What the tables hold of a frame, and the stars of its fit."""

    stamp_ns: int
    state: TrackerState
    residual_px: float
    attitude: Attitude | None
    rate_rad_s: np.ndarray | None
    truth: np.ndarray | None
    stars: FittedStars
    fit: FrameFit | None


class SegmentTables:
    """Collects the frames of a segment; the tables are computed from all of them at once."""

    def __init__(self) -> None:
        self._frames: list[_Frame] = []

    def add(self, stamp_ns: int, frame: FrameResult, residual_px: float,
            truth: np.ndarray | None, stars: FittedStars, fit: FrameFit | None) -> None:
        """Add a frame, its true attitude (4,) where the bag holds it, and the fit of its stars."""
        attitude = frame.attitude
        self._frames.append(_Frame(
            stamp_ns, frame.state, residual_px, attitude,
            None if frame.tracked is None else frame.tracked.rate_rad_s, truth, stars, fit))

    def tables(self, begin_ns: int, camera: Camera) -> dict[str, np.ndarray]:
        """Return the tables frames, lens, stars and widths of a segment."""
        fitted = [frame for frame in self._frames if frame.fit is not None]
        return {'frames': self._frame_rows(), 'lens': _lens_rows(fitted),
                'stars': _star_rows(fitted, begin_ns),
                'widths': width_rows([(frame.stars, frame.fit) for frame in fitted if frame.fit],
                                     camera, begin_ns)}

    def _frame_rows(self) -> np.ndarray:
        """Return the table frames."""
        frames = self._frames
        rows = np.zeros(len(frames), FRAME_DTYPE)
        for name in FRAME_DTYPE.names or ():
            if FRAME_DTYPE[name].kind == 'f':
                rows[name] = np.nan
        if not frames:
            return rows
        rows['stamp_ns'] = [frame.stamp_ns for frame in frames]
        rows['state'] = [STATES.index(frame.state.value) for frame in frames]
        rows['residual_px'] = [frame.residual_px for frame in frames]
        attitudes = [frame.attitude for frame in frames if frame.attitude is not None]
        known = np.array([frame.attitude is not None for frame in frames])
        if attitudes:
            quaternion = np.array([attitude.quaternion for attitude in attitudes])
            covariance = np.array([attitude.covariance_sensor for attitude in attitudes])
            rows['stars'][known] = [attitude.stars for attitude in attitudes]
            fill(rows, 'q_{}', 'xyzw', quaternion.T, known)
            fill(rows, 'cov_{}_rad2', PAIRS, covariance[:, UPPER[0], UPPER[1]].T, known)
            fill(rows, 'protection_{}_rad', 'xyz',
                 np.array([attitude.protection_rad for attitude in attitudes]).T, known)
            rate, truth = (np.array([np.full(size, np.nan) if value is None else value
                                     for value in values]) for size, values in (
                (3, [frame.rate_rad_s for frame in frames]),
                (4, [frame.truth for frame in frames])))
            fill(rows, 'rate_{}_rad_s', 'xyz', rate[known].T, known)
            fill(rows, 'error_{}_arcsec', 'xyz',
                 attitude_error(quaternion, truth[known]).T / ARCSEC, known)
        fits = [frame.fit for frame in frames if frame.fit is not None]
        if fits:
            known = np.array([frame.fit is not None for frame in frames])
            covariance = np.array([fit.covariance for fit in fits]) / ARCSEC ** 2
            fill(rows, 'single_{}_arcsec', 'xyz',
                 np.array([fit.turn_rad for fit in fits]).T / ARCSEC, known)
            fill(rows, 'single_cov_{}_arcsec2', PAIRS, covariance[:, UPPER[0], UPPER[1]].T, known)
            rows['zero_point_mag'][known] = [fit.zero_point_mag for fit in fits]
        return rows


def _lens_rows(frames: Sequence[_Frame]) -> np.ndarray:
    """Return the table lens of frames with a fit."""
    number = np.array([frame.stamp_ns for frame in frames], np.int64) // round(LENS_BIN_S * 1e9)
    bins, which = np.unique(number, return_inverse=True)
    rows = np.zeros(len(bins), LENS_DTYPE)
    rows['stamp_ns'] = np.rint((bins + 0.5) * LENS_BIN_S * 1e9)
    rows['frames'] = np.bincount(which, minlength=len(bins))
    sums = np.array([frame.fit.lens for frame in frames if frame.fit]).reshape(-1, 5)
    for name, column in zip(('ff', 'fk', 'kk', 'f', 'k'), sums.T):
        rows[name] = np.bincount(which, column, len(bins))
    return rows


def _star_rows(frames: Sequence[_Frame], begin_ns: int) -> np.ndarray:
    """Return the table stars of frames with a fit."""
    fits = [frame.fit for frame in frames if frame.fit is not None]
    if not fits:
        return np.empty(0, STAR_DTYPE)
    hip = np.concatenate([frame.stars.hip for frame in frames])
    weight = (ARCSEC / np.concatenate([fit.sigma for fit in fits])) ** 2
    east, north = np.concatenate([fit.residual for fit in fits]).T / ARCSEC
    difference = np.concatenate([fit.zero_point_mag - fit.zero_point for fit in fits])
    magnitude = np.concatenate([fit.magnitude for fit in fits])
    known, first, which = np.unique(hip, return_index=True, return_inverse=True)
    rows = np.zeros(len(known), STAR_DTYPE)
    rows['stamp_ns'], rows['hip'], rows['magnitude'] = begin_ns, known, magnitude[first]
    for name, values in (
            ('count', np.ones(len(hip))), ('weight', weight), ('east', weight * east),
            ('north', weight * north), ('chi2', weight * (east ** 2 + north ** 2)),
            ('difference_mag', difference), ('square_mag2', difference ** 2)):
        rows[name] = np.bincount(which, values, len(known))
    return rows


def fill(rows: np.ndarray, pattern: str, names: Sequence[str], values: np.ndarray,
         known: np.ndarray | slice = slice(None)) -> None:
    """Set columns, by a pattern of their names, of the known rows to values (K, N)."""
    for name, column in zip(names, values):
        rows[pattern.format(name)][known] = column


def write_tables(tables: Mapping[str, np.ndarray], folder: Path, tracker: str, name: str
                 ) -> list[str]:
    """Write tables to TABLE/day=DAY/tracker=TRACKER/NAME.parquet; return these paths."""
    paths = []
    for table, rows in tables.items():
        days = rows['stamp_ns'] // _DAY_NS
        for day in np.unique(days):
            date = np.datetime64(int(day), 'D')
            path = Path(table, f'day={date}', f'tracker={tracker}', f'{name}.parquet')
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            _write(rows[days == day], folder / path)
            paths.append(str(path))
    return paths


def _write(rows: np.ndarray, path: Path) -> None:
    pyarrow = load_parquet_writer()
    columns = {name: pyarrow.array(np.ascontiguousarray(rows[name]), from_pandas=True)
               for name in rows.dtype.names or ()}
    pyarrow.parquet.write_table(pyarrow.table(columns), path, compression='zstd')


def accuracy(rows: np.ndarray) -> tuple[int, float, float]:
    """Return the frames with truth, the sums of errors^2 across the boresight and of the NEES."""
    error = np.stack([rows[f'error_{axis}_arcsec'] for axis in 'xyz'], -1).astype(float)
    known = np.isfinite(error).all(axis=1)
    covariance = np.empty((np.count_nonzero(known), 3, 3))
    for pair, i, j in zip(PAIRS, *UPPER):
        covariance[:, i, j] = covariance[:, j, i] = rows[f'cov_{pair}_rad2'][known]
    error = error[known]
    nees = nees_of(error * ARCSEC, covariance)
    return len(error), float((error[:, :2] ** 2).sum()), float(nees.sum())


def file_spans_ns(folder: Path, table: str, tracker: str) -> list[tuple[int, int, str]]:
    """Return the first and last stamp of each file of a table, and the name of its recording."""
    pyarrow = load_parquet_writer()
    spans = []
    for path in (folder / table).glob(f'day=*/tracker={tracker}/*.parquet'):
        metadata = pyarrow.parquet.ParquetFile(path).metadata
        column = metadata.schema.to_arrow_schema().names.index('stamp_ns')
        found = [metadata.row_group(group).column(column).statistics
                 for group in range(metadata.num_row_groups)]
        spans.append((min(each.min for each in found), max(each.max for each in found),
                      _recording(path)))
    return sorted(spans)


def _recording(path: Path) -> str:
    """Return the name of the recording of a file, whose name ends with the begin of a segment."""
    return path.stem.rpartition('_')[0]


def read_table(folder: Path, table: str, tracker: str, columns: list[str], day: str = '*'
               ) -> dict[str, np.ndarray]:
    """
    Return columns of a table of a run, of a day or all, in the order of their stamps.

    The column bag is that of the name of the recording.
    """
    pyarrow = load_parquet_writer()
    parts: dict[str, list[np.ndarray]] = {name: [] for name in columns}
    for path in sorted((folder / table).glob(f'day={day}/tracker={tracker}/*.parquet')):
        read = pyarrow.parquet.ParquetFile(path).read([name for name in columns if name != BAG])
        for name in columns:
            parts[name].append(np.full(len(read), _recording(path), object)
                               if name == BAG else read.column(name).to_numpy())
    joined = {name: np.concatenate(part) if part else np.empty(0)
              for name, part in parts.items()}
    order = np.argsort(joined['stamp_ns'], kind='stable')
    return {name: column[order] for name, column in joined.items()}


# --- a run on disk: its trackers and tables ---


@dataclass(frozen=True)
class Run:
    """The folder of one run of reprocess, and its star trackers."""

    folder: Path
    trackers: tuple[str, ...]

    @property
    def days(self) -> list[str]:
        """The days with frames, as 2026-01-01."""
        return sorted(path.name.removeprefix('day=')
                      for path in (self.folder / 'tables' / 'frames').glob('day=*'))

    def same_times(self, tracker: str) -> str:
        """Return which bags of a tracker hold frames of the same times, empty where none do."""
        newest: dict[str, int] = {}
        for begin_ns, end_ns, bag in file_spans_ns(self.folder / 'tables', 'frames', tracker):
            for other, other_end_ns in newest.items():
                if other != bag and begin_ns <= other_end_ns:
                    return (f'{tracker}: the bags {other} and {bag} both hold frames of '
                            f'{utc(begin_ns)} to {utc(min(end_ns, other_end_ns))}: for figures '
                            'of one, reprocess it into a folder of its own')
            newest[bag] = max(end_ns, newest.get(bag, 0))
        return ''

    def table(self, name: str, tracker: str, columns: list[str], day: str = '*'
              ) -> dict[str, np.ndarray]:
        """Return columns of a table in the order of the stamps; unknown values are NaN."""
        return read_table(self.folder / 'tables', name, tracker, columns, day)

    def vectors(self, table: dict[str, np.ndarray], pattern: str, names: str = 'xyz'
                ) -> np.ndarray:
        """Return columns (N, K) by a pattern of their names."""
        return np.stack([table[pattern.format(name)].astype(float) for name in names], -1)


def open_run(folder: Path) -> Run:
    """Return the run in a folder; BagError if there is none."""
    path = folder / SUMMARY
    try:
        content = json.loads(path.read_text())
        return Run(folder, tuple(content['trackers']))
    except (OSError, ValueError, KeyError, TypeError) as error:
        sets = sorted(found.parent.name for found in folder.glob(f'*/{SUMMARY}'))
        hint = f'; it holds the runs {", ".join(sets)}' if sets else ''
        raise BagError(
            f'{folder} is not a finished run of `startracker reprocess`{hint}') from error
