# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Clouds `centroids`, `stars`, `tracks` and `tracker_state` out of results of the stages."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids, UNKNOWN_EXPOSURE
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, STAR_DTYPE, TRACK_DTYPE

if TYPE_CHECKING:
    from startracker_ros.core.track.track_filter import TrackFilter

_TRACK_FIELDS = list(TRACK_DTYPE.names or ())[3:]
_TABLE_FIELDS = ['u_px', 'v_px', 'flux_dn', 'snr', 'sigma_px', 'hip', 'magnitude', 'residual_px',
                 'track_id', 'age', 'missed', 'association_probability', 'u_rate_px_s',
                 'v_rate_px_s', 'cov_uu_px2', 'cov_uv_px2', 'cov_vv_px2']
"""Fields of a STAR_TRACK in the order of those of a cloud behind x, y, z."""


def centroid_rows(centroids: Centroids, camera: Camera, windowed: bool = False) -> np.ndarray:
    """Return rows (N,) of `centroids`; windowed if only predicted stars were measured."""
    rows = _measured_rows(CENTROID_DTYPE, centroids, camera)
    rows['directed'] = windowed
    return rows


def star_rows(centroids: Centroids, hip: np.ndarray, magnitude: np.ndarray,
              residual_px: np.ndarray, camera: Camera) -> np.ndarray:
    """Return rows (N,) of `stars`: centroids with a catalogue number each, 0 for none."""
    rows = _measured_rows(STAR_DTYPE, centroids, camera)
    rows['hip'], rows['magnitude'], rows['residual_px'] = hip, magnitude, residual_px
    return rows


def track_rows(tracks: Tracks, camera: Camera) -> np.ndarray:
    """Return rows (N,) of `tracks`."""
    rows = np.zeros(len(tracks), TRACK_DTYPE)
    rows[_TRACK_FIELDS] = tracks.table()[_TABLE_FIELDS]
    _floats(rows)[:, :3] = camera.unproject(tracks.uv)
    return rows


def centroids_from_rows(rows: np.ndarray) -> Centroids:
    """Return the centroids of `centroids` or `stars` rows."""
    table = _floats(rows).take(_columns(rows.dtype), axis=1).astype(float)
    exposure_s = UNKNOWN_EXPOSURE
    if len(rows) and rows['exposure_max'][0] > 0:
        exposure_s = float(rows['exposure_min'][0]), float(rows['exposure_max'][0])
    if not (table[:, 5] > 0).all():
        # The covariance is not known: round.
        table[:, 5] = table[:, 7] = table[:, 4] ** 2
        table[:, 6] = 0
    return Centroids.of(table, exposure_s)


def _floats(rows: np.ndarray) -> np.ndarray:
    """Return rows (N,) as float32 (N, K), a view where they are contiguous."""
    return np.ascontiguousarray(rows).view('f4').reshape(len(rows), rows.dtype.itemsize // 4)


@lru_cache
def _columns(dtype: np.dtype) -> np.ndarray:
    """Return where in rows viewed as floats the columns (12,) of Centroids.table() are."""
    fields = dict(dtype.fields or {})
    return np.array([fields[name][1] // 4 for name in (
        'u', 'v', 'flux', 'snr', 'sigma_px', 'cov_uu', 'cov_uv', 'cov_vv', 'common_uu',
        'common_uv', 'common_vv', 'stamp_offset')])


def _measured_rows(dtype: np.dtype, centroids: Centroids, camera: Camera) -> np.ndarray:
    """Return rows of centroids with their covariance and the time of their row."""
    rows, table = np.zeros(len(centroids), dtype), centroids.table().copy()
    # Zero is unknown: a sigma that is NaN is to be named by who needs it.
    np.nan_to_num(table[:, 5:8], copy=False, posinf=0.0)
    floats = _floats(rows)
    floats[:, :3], floats[:, _columns(dtype)] = camera.unproject(centroids.uv), table
    if centroids.exposure_s != UNKNOWN_EXPOSURE:
        rows['exposure_min'], rows['exposure_max'] = centroids.exposure_s
    return rows


# --- the values of tracker_state, as the node publishes them and reprocessing writes them ---

STATE_NAME = 'star_tracker: state'


def tracker_state_values(tracker: 'TrackFilter') -> dict[str, object]:
    """Return the values of a tracker after its newest frame."""
    return {
        'stars_matched': tracker.stars_matched,
        'residual_px': f'{tracker.residual_px:.3f}',
        'frames_since_fix': tracker.frames_since_fix,
        'checks_passed': tracker.checks_passed,
        'late_frames': tracker.late_frames,
        'rejected_centroids': tracker.rejected_centroids,
        'gyro': tracker.gyro_condition,
        'stamp_sigma_ms': f'{tracker.stamp_sigma_s * 1e3:.3f}',
        **_budget_values(tracker),
        'reason': tracker.contradiction or tracker.reason}


def _budget_values(tracker: 'TrackFilter') -> dict[str, str]:
    """Return 1 sigma about x, y, z of each term of the error budget, with an attitude alone."""
    budget = None if tracker.attitude is None else tracker.attitude.attitude.budget
    return {} if budget is None else {
        f'error_budget.{name}_arcsec': ' '.join(f'{one:.3g}' for one in sigma.tolist())
        for name, sigma in budget.sigma_arcsec.items()}
