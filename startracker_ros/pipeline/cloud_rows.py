"""Rows of the clouds `centroids`, `stars` and `tracks` out of results of the stages."""

import numpy as np
from startracker_ros.bag.layouts import CENTROID_DTYPE, STAR_DTYPE, TRACK_DTYPE
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids, ROUND
from startracker_ros.track.tracks import Tracks


def centroid_rows(centroids: Centroids, camera: Camera, directed: bool = False) -> np.ndarray:
    """Return rows (N,) of `centroids`; directed if only predicted stars were measured."""
    rows = _measured_rows(CENTROID_DTYPE, centroids, camera)
    rows['directed'] = directed
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
    known = rows['cov_uu'] > 0
    uv = np.empty((len(rows), 2))
    uv[:, 0], uv[:, 1] = rows['u'], rows['v']
    return Centroids(
        uv=uv, flux=rows['flux'].astype(float),
        snr=rows['snr'].astype(float), sigma_px=rows['sigma_px'].astype(float),
        covariance=_matrices(rows, 'cov') if known.all() else ROUND,
        delay_s=rows['stamp_offset'].astype(float), common=_matrices(rows, 'common'))


def _matrices(rows: np.ndarray, name: str) -> np.ndarray:
    """Return the matrices (N, 2, 2) of columns uu, uv and vv."""
    found = np.empty((len(rows), 2, 2))
    found[:, 0, 0], found[:, 1, 1] = rows[f'{name}_uu'], rows[f'{name}_vv']
    found[:, 0, 1] = found[:, 1, 0] = rows[f'{name}_uv']
    return found


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
    return rows
