"""Tables of a run: what a segment collects, and Parquet files by day and tracker."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from startracker_ros.catalog.onboard import OnboardCatalog
from startracker_ros.export.tables import load_parquet_writer
from startracker_ros.maths.rotation import ARCSEC, attitude_error
from startracker_ros.pipeline.pipeline import PipelineFrame
from startracker_ros.reprocess.frame_fit import FrameFit

STATES = ('LOST', 'ACQUIRING', 'TRACKING')
PAIRS = ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')
UPPER = np.triu_indices(3)
LENS_BIN_S = 60.0
_DAY_NS = 86_400 * 10 ** 9

FRAME_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), ('state', 'i1'), ('stars', 'i2'), ('residual_px', 'f4'),
    *((f'q_{axis}', 'f8') for axis in 'xyzw'),
    *((f'cov_{pair}_rad2', 'f4') for pair in PAIRS),
    *((f'rate_{axis}_rad_s', 'f8') for axis in 'xyz'),
    *((f'single_{axis}_arcsec', 'f4') for axis in 'xyz'),
    *((f'single_cov_{pair}_arcsec2', 'f4') for pair in PAIRS),
    ('zero_point_mag', 'f4'), *((f'error_{axis}_arcsec', 'f4') for axis in 'xyz')])
"""One row for each frame; single is the turn from the tracked attitude to that of the frame's
stars alone, error that from the truth to the attitude. Unknown values are NaN."""

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


def _empty_row() -> np.ndarray:
    row = np.zeros(1, FRAME_DTYPE)
    for name in FRAME_DTYPE.names or ():
        if FRAME_DTYPE[name].kind == 'f':
            row[name] = np.nan
    return row


_EMPTY = _empty_row()


class SegmentTables:
    """Collects the frames of a segment."""

    def __init__(self) -> None:
        self._frames: list[np.ndarray] = []
        self._lens: dict[int, np.ndarray] = {}
        self._stars: list[np.ndarray] = []

    def add(self, stamp_ns: int, frame: PipelineFrame, residual_px: float,
            truth: np.ndarray | None) -> None:
        """Add a frame; truth is its true attitude (4,) where the bag holds it."""
        row = _EMPTY.copy()
        row['stamp_ns'], row['state'] = stamp_ns, STATES.index(frame.state.value)
        row['residual_px'] = residual_px
        attitude = frame.trusted.attitude
        if attitude is not None:
            row['stars'] = attitude.stars
            fill(row, 'q_{}', 'xyzw', attitude.quaternion)
            fill(row, 'cov_{}_rad2', PAIRS, attitude.covariance_sensor[UPPER])
            if frame.tracked is not None:
                fill(row, 'rate_{}_rad_s', 'xyz', frame.tracked.rate_rad_s)
            if truth is not None:
                fill(row, 'error_{}_arcsec', 'xyz',
                     attitude_error(attitude.quaternion, truth) / ARCSEC)
        self._frames.append(row)

    def add_fit(self, stamp_ns: int, fit: FrameFit, onboard: OnboardCatalog,
                star_index: np.ndarray, flux: np.ndarray) -> None:
        """Add the fit of the last frame: star_index and flux (N,) of its stars."""
        row = self._frames[-1]
        fill(row, 'single_{}_arcsec', 'xyz', fit.turn_rad / ARCSEC)
        fill(row, 'single_cov_{}_arcsec2', PAIRS, fit.covariance[UPPER] / ARCSEC ** 2)
        magnitude = onboard.magnitude[star_index]
        with np.errstate(invalid='ignore', divide='ignore'):
            zero = magnitude + 2.5 * np.log10(flux)
        row['zero_point_mag'] = np.median(zero)
        number = stamp_ns // round(LENS_BIN_S * 1e9)
        lens = self._lens.setdefault(number, np.zeros(6))
        lens += (1, fit.lens_information[0, 0], fit.lens_information[0, 1],
                 fit.lens_information[1, 1], *fit.lens_vector)
        sigma, residual = fit.sigma / ARCSEC, fit.residual / ARCSEC
        self._stars.append(np.stack([
            onboard.hip[star_index], magnitude, 1 / sigma ** 2, *residual.T,
            np.median(zero) - zero], -1))

    def tables(self, begin_ns: int) -> dict[str, np.ndarray]:
        """Return the tables frames, lens and stars of a segment."""
        frames = np.concatenate(self._frames) if self._frames else np.empty(0, FRAME_DTYPE)
        lens = np.zeros(len(self._lens), LENS_DTYPE)
        for row, (number, sums) in zip(lens, sorted(self._lens.items())):
            row['stamp_ns'] = round((number + 0.5) * LENS_BIN_S * 1e9)
            for name, value in zip(('frames', 'ff', 'fk', 'kk', 'f', 'k'), sums):
                row[name] = value
        return {'frames': frames, 'lens': lens, 'stars': self._star_sums(begin_ns)}

    def _star_sums(self, begin_ns: int) -> np.ndarray:
        if not self._stars:
            return np.empty(0, STAR_DTYPE)
        hip, magnitude, weight, east, north, difference = np.concatenate(self._stars).T
        known, first, which = np.unique(hip, return_index=True, return_inverse=True)
        rows = np.zeros(len(known), STAR_DTYPE)
        rows['stamp_ns'], rows['hip'], rows['magnitude'] = begin_ns, known, magnitude[first]
        for name, values in (
                ('count', np.ones(len(hip))), ('weight', weight), ('east', weight * east),
                ('north', weight * north), ('chi2', weight * (east ** 2 + north ** 2)),
                ('difference_mag', difference), ('square_mag2', difference ** 2)):
            rows[name] = np.bincount(which, values, len(known))
        return rows


def fill(row: np.ndarray, pattern: str, names: Sequence[str], values: np.ndarray) -> None:
    """Set columns, by a pattern of their names, to values (K,) or (K, N)."""
    for name, value in zip(names, values):
        row[pattern.format(name)] = value


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
    nees = np.einsum('ni,nij,nj->n', error, np.linalg.inv(covariance / ARCSEC ** 2), error)
    return len(error), float((error[:, :2] ** 2).sum()), float(nees.sum())


def days_of(folder: Path, table: str) -> list[str]:
    """Return the days that a table of a run has, as 2026-01-01."""
    return sorted(path.name.removeprefix('day=') for path in (folder / table).glob('day=*'))


def read_table(folder: Path, table: str, tracker: str, columns: list[str], day: str = '*'
               ) -> dict[str, np.ndarray]:
    """Return columns of a table of a run, of a day or all, in the order of their stamps."""
    pyarrow = load_parquet_writer()
    parts: dict[str, list[np.ndarray]] = {name: [] for name in columns}
    for path in sorted((folder / table).glob(f'day={day}/tracker={tracker}/*.parquet')):
        read = pyarrow.parquet.ParquetFile(path).read(columns)
        for name in columns:
            parts[name].append(read.column(name).to_numpy())
    joined = {name: np.concatenate(part) if part else np.empty(0)
              for name, part in parts.items()}
    order = np.argsort(joined['stamp_ns'], kind='stable')
    return {name: column[order] for name, column in joined.items()}
