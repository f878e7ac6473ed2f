# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Series of bins out of the tables of a run, a day at a time."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, multiply, quaternion_from_rotation_vector)
from startracker_ros.tools.reprocess.tables import LENS_BIN_S, Run

_SAME = 0.6
"""Frames of two heads belong together up to this share of the interval between frames."""


@dataclass(frozen=True)
class Series:
    """A quantity over time: bins at stamp_ns (N,), values (N, K) of columns in a unit."""

    name: str
    unit: str
    columns: tuple[str, ...]
    stamp_ns: np.ndarray
    values: np.ndarray


def all_series(run: Run) -> list[Series]:
    """Return focal length and zero point of each tracker, and the mounts of all to the first."""
    found = [series for tracker in run.trackers
             for series in (_focal(run, tracker), _zero_point(run, tracker))]
    return found + [_mount(run, run.trackers[0], other) for other in run.trackers[1:]]


def distortion(run: Run, tracker: str) -> tuple[float, float]:
    """Return k1 over the run, fitted with the focal length, minus that of the camera."""
    lens = run.table('lens', tracker, ['stamp_ns', 'ff', 'fk', 'kk', 'f', 'k'])
    ff, fk, kk, f, k = (float(lens[name].sum()) for name in ('ff', 'fk', 'kk', 'f', 'k'))
    determinant = ff * kk - fk * fk
    if not determinant > 0:
        return np.nan, np.nan
    return (ff * k - fk * f) / determinant, float(np.sqrt(ff / determinant))


def _focal(run: Run, tracker: str) -> Series:
    lens = run.table('lens', tracker, ['stamp_ns', 'frames', 'ff', 'f'])
    stamps, which = np.unique(lens['stamp_ns'], return_inverse=True)
    sums = {name: np.bincount(which, lens[name], len(stamps)) for name in ('frames', 'ff', 'f')}
    # A bin of few frames is one at the end of a segment, or of a gap.
    full = sums['frames'] >= 0.5 * np.median(sums['frames'] if len(stamps) else 0.0)
    return Series(f'{tracker} focal length', '%', ('focal',), stamps[full],
                  100 * (sums['f'] / sums['ff'])[full, None])


def _zero_point(run: Run, tracker: str) -> Series:
    stamps, means = [], []
    for day in run.days:
        frames = run.table('frames', tracker, ['stamp_ns', 'zero_point_mag'], day)
        bins = _binned(frames['stamp_ns'], frames['zero_point_mag'][:, None].astype(float))
        stamps.append(bins[0])
        means.append(bins[1])
    return Series(f'{tracker} zero point', 'mag', ('zero point',), np.concatenate(stamps),
                  np.concatenate(means))


class _Singles(NamedTuple):
    """Attitudes (N, 4) of single frames at stamps (N,), and the body rates (N, 3)."""

    stamp_ns: np.ndarray
    quaternion: np.ndarray
    rate_rad_s: np.ndarray

    @classmethod
    def read(cls, run: Run, tracker: str, day: str) -> '_Singles':
        """Return those of a day."""
        table = run.table('frames', tracker, [
            'stamp_ns', *(f'q_{axis}' for axis in 'xyzw'),
            *(f'single_{axis}_arcsec' for axis in 'xyz'),
            *(f'rate_{axis}_rad_s' for axis in 'xyz')], day)
        turn = run.vectors(table, 'single_{}_arcsec') * ARCSEC
        known = np.isfinite(turn).all(axis=1)
        q = run.vectors(table, 'q_{}', 'xyzw')[known]
        return cls(table['stamp_ns'][known],
                   multiply(q, quaternion_from_rotation_vector(turn[known])),
                   run.vectors(table, 'rate_{}_rad_s')[known])


def _mount(run: Run, first: str, second: str) -> Series:
    """Return the turn of the second head against the first, about its own axes."""
    stamps: list[np.ndarray] = [np.empty(0, np.int64)]
    turns: list[np.ndarray] = [np.empty((0, 3))]
    reference: np.ndarray | None = None
    for day in run.days:
        stamp_ns, relative = _relative(*(
            _Singles.read(run, tracker, day) for tracker in (first, second)))
        if not len(stamp_ns):
            continue
        if reference is None:
            reference = relative[len(relative) // 2]
        bins = _binned(stamp_ns, attitude_error(relative, reference) / ARCSEC)
        stamps.append(bins[0])
        turns.append(bins[1])
    return Series(f'{first} to {second} mount', 'arcsec', ('x', 'y', 'z'),
                  np.concatenate(stamps), np.concatenate(turns))


def _relative(one: _Singles, two: _Singles) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (M,) and the rotations (M, 4) first from second of frames of one time."""
    if len(one.stamp_ns) < 2 or len(two.stamp_ns) < 2:
        return np.empty(0, np.int64), np.empty((0, 4))
    nearest = np.clip(np.searchsorted(one.stamp_ns, two.stamp_ns), 1, len(one.stamp_ns) - 1)
    nearest -= (two.stamp_ns - one.stamp_ns[nearest - 1]
                < one.stamp_ns[nearest] - two.stamp_ns)
    apart_s = (two.stamp_ns - one.stamp_ns[nearest]) * 1e-9
    close = np.abs(apart_s) <= _SAME * float(np.median(np.diff(two.stamp_ns))) * 1e-9
    nearest, turn = nearest[close], apart_s[close, None]
    moved = multiply(one.quaternion[nearest], quaternion_from_rotation_vector(
        np.where(turn == 0, 0.0, one.rate_rad_s[nearest] * turn)))
    return two.stamp_ns[close], multiply(conjugate(moved), two.quaternion[close])


def _binned(stamp_ns: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (M,) and means (M, K) of bins of a minute, of values (N, K)."""
    known = np.isfinite(values).all(axis=1)
    number = stamp_ns[known] // round(LENS_BIN_S * 1e9)
    bins, which = np.unique(number, return_inverse=True)
    count = np.bincount(which, minlength=len(bins))
    means = np.stack([np.bincount(which, column, len(bins)) / np.maximum(count, 1)
                      for column in values[known].T], -1) if len(bins) else np.empty(
                          (0, values.shape[1]))
    full = count >= 0.5 * np.median(count) if len(bins) else np.empty(0, bool)
    return ((bins + 0.5) * LENS_BIN_S * 1e9).astype(np.int64)[full], means[full]
