# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude, tracks and diagnostics as tables of columns, for CSV and Parquet."""

from collections.abc import Mapping
import csv
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.extras import extra
from startracker_ros.core.maths.rotation import pointing_from_quaternion
from startracker_ros.io.output import output_file
from startracker_ros.io.recordings.recording import ATTITUDE_TOPICS, lock_segments, Recording

Table = Mapping[str, np.ndarray]
"""Columns (N,) by name; the names carry the units."""


def attitude_table(recording: Recording) -> Table:
    """Return a row for each attitude: quaternion, pointing, covariance, rate, error, bound."""
    stamps, count = recording.attitude_ns, len(recording.attitude_ns)
    pointing = np.degrees([pointing_from_quaternion(q) for q in recording.quaternion])
    error = np.full((count, 3), np.nan)
    known, value, _ = recording.errors()
    error[np.searchsorted(stamps, known)] = value
    covariance = recording.covariance_sensor
    pairs = [(row, column) for row in range(3) for column in range(row, 3)]
    return {
        'stamp_ns': stamps, 'segment': lock_segments(recording),
        **dict(zip(('q_x', 'q_y', 'q_z', 'q_w'), recording.quaternion.T)),
        **dict(zip(('ra_deg', 'dec_deg', 'roll_deg'), pointing.reshape(-1, 3).T)),
        **{f'cov_{"xyz"[i]}{"xyz"[j]}_rad2': covariance[:, i, j] for i, j in pairs},
        **{f'rate_{axis}_rad_s': rate for axis, rate in zip('xyz', recording.rate_rad_s.T)},
        **{f'error_{axis}_arcsec': column for axis, column in zip('xyz', error.T)},
        **{f'protection_{axis}_rad': bound for axis, bound in zip(
            'xyz', recording.protection_rad.T)}}


def tracks_table(recording: Recording) -> Table:
    """Return a row for each track of each frame, with the fields of the `tracks` cloud."""
    rows = recording.tracks.rows
    return {'stamp_ns': recording.tracks.stamp_ns[recording.tracks.frame],
            **{name: rows[name] for name in rows.dtype.names or ()}}


def diagnostics_table(recording: Recording) -> Table:
    """Return a row for each value of each status; one row without a key if it has no values."""
    columns: dict[str, list[Any]] = {name: [] for name in (
        'stamp_ns', 'received_ns', 'name', 'hardware_id', 'level', 'message', 'key', 'value')}
    for record in recording.diagnostics:
        for key, value in record.values or (('', ''),):
            row = (record.stamp_ns, record.received_ns, record.name, record.hardware_id,
                   record.level, record.message, key, value)
            for column, cell in zip(columns.values(), row):
                column.append(cell)
    kinds = {'stamp_ns': np.int64, 'received_ns': np.int64, 'level': np.int16}
    return {name: np.array(column, kinds.get(name, object)) for name, column in columns.items()}


TABLES = {'attitude': attitude_table, 'tracks': tracks_table, 'diagnostics': diagnostics_table}
TABLE_TOPICS = {'attitude': ATTITUDE_TOPICS, 'tracks': ('tracks',),
                'diagnostics': ('/diagnostics',)}
"""The relative topics that the rows of each table are from."""


def write_csv(table: Table, path: Path) -> None:
    """Write a table with one line of names; UTC next to the stamp, nothing for what is unknown."""
    columns = {'utc': np.array([utc(stamp, digits=9) for stamp in table['stamp_ns']], object),
               **{name: _cells(column) for name, column in table.items()}}
    with output_file(path) as file:
        text = TextIOWrapper(file, newline='', encoding='utf-8')
        writer = csv.writer(text)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values()))
        # Written out, and left open.
        text.detach()


def _cells(column: np.ndarray) -> np.ndarray:
    if column.dtype.kind != 'f':
        return column
    # The shortest text that reads back as the same number, of float32 as of float64.
    text = column.astype(str).astype(object)
    text[np.isnan(column)] = ''
    return text


def load_parquet_writer() -> Any:
    """Return pyarrow with its parquet module; MissingLibraryError without the library."""
    with extra('parquet', 'pyarrow', 'Parquet'):
        import pyarrow
        import pyarrow.parquet
    return pyarrow


def write_parquet(table: Table, path: Path) -> None:
    """Write a table; utc is a timestamp next to the stamp, what is unknown is null."""
    pyarrow = load_parquet_writer()
    columns = {'utc': pyarrow.array(table['stamp_ns'], pyarrow.timestamp('ns', tz='UTC'))}
    for name, column in table.items():
        kind = pyarrow.string() if column.dtype == object else None
        columns[name] = pyarrow.array(column, kind, from_pandas=True)
    with output_file(path) as file:
        pyarrow.parquet.write_table(pyarrow.table(columns), file)
