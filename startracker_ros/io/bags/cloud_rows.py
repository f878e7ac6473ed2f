# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Clouds `centroids`, `stars`, `tracks` and `tracker_state` out of results of the stages."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids, ROUND, UNKNOWN_EXPOSURE
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, STAR_DTYPE, TRACK_DTYPE

if TYPE_CHECKING:
    from startracker_ros.core.track.track_filter import TrackFilter


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
    rows = _rows(TRACK_DTYPE, tracks.uv, tracks.flux, tracks.snr, tracks.sigma_px, camera)
    for name in ('hip', 'magnitude', 'residual_px', 'track_id', 'age', 'missed',
                 'association_probability'):
        rows[name] = getattr(tracks, name)
    rows['u_rate'], rows['v_rate'] = tracks.velocity.T
    rows['cov_uu'], rows['cov_vv'] = tracks.covariance[:, 0, 0], tracks.covariance[:, 1, 1]
    rows['cov_uv'] = tracks.covariance[:, 0, 1]
    return rows


def centroids_from_rows(rows: np.ndarray) -> Centroids:
    """Return the centroids of `centroids` or `stars` rows."""
    fields = np.ascontiguousarray(rows).view('f4').reshape(len(rows), rows.dtype.itemsize // 4)
    columns = fields.take(_columns(rows.dtype), axis=1).astype(float)
    flux, snr, sigma_px, delay_s = columns[:, 2:6].T.copy()
    covariance = columns[:, 6:10].reshape(-1, 2, 2)
    known = bool((covariance[:, 0, 0] > 0).all())
    exposure_s = UNKNOWN_EXPOSURE
    if len(rows) and rows['exposure_max'][0] > 0:
        exposure_s = float(rows['exposure_min'][0]), float(rows['exposure_max'][0])
    return Centroids(columns[:, :2], flux, snr, sigma_px, covariance if known else ROUND, delay_s,
                     columns[:, 10:].reshape(-1, 2, 2), exposure_s)


@lru_cache
def _columns(dtype: np.dtype) -> np.ndarray:
    """Return where in rows viewed as floats the columns of Centroids are, matrices by rows."""
    pairs = ('uu', 'uv', 'uv', 'vv')
    fields = dict(dtype.fields or {})
    return np.array([fields[name][1] // 4 for name in (
        'u', 'v', 'flux', 'snr', 'sigma_px', 'stamp_offset', *(f'cov_{pair}' for pair in pairs),
        *(f'common_{pair}' for pair in pairs))])


def _rows(dtype: np.dtype, uv: np.ndarray, flux: np.ndarray, snr: np.ndarray,
          sigma_px: np.ndarray, camera: Camera) -> np.ndarray:
    rows = np.zeros(len(uv), dtype)
    directions = camera.unproject(uv)
    for column, name in enumerate('xyz'):
        rows[name] = directions[:, column]
    rows['u'], rows['v'] = uv[:, 0], uv[:, 1]
    rows['flux'], rows['snr'], rows['sigma_px'] = flux, snr, sigma_px
    return rows


def _measured_rows(dtype: np.dtype, centroids: Centroids, camera: Camera) -> np.ndarray:
    """Return rows of centroids with their covariance and the time of their row."""
    rows = _rows(dtype, centroids.uv, centroids.flux, centroids.snr, centroids.sigma_px, camera)
    # Zero is unknown: a sigma that is NaN is to be named by who needs it.
    covariance = np.nan_to_num(centroids.covariance, posinf=0.0)
    rows['cov_uu'], rows['cov_vv'] = covariance[:, 0, 0], covariance[:, 1, 1]
    rows['cov_uv'], rows['stamp_offset'] = covariance[:, 0, 1], centroids.delay_s
    common = centroids.common
    rows['common_uu'], rows['common_vv'] = common[:, 0, 0], common[:, 1, 1]
    rows['common_uv'] = common[:, 0, 1]
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
