"""The clouds `centroids`, `stars`, `truth/stars` and `tracks`: sensor_msgs/PointCloud2."""

from typing import TYPE_CHECKING

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from startracker_ros.bag.layouts import (
    CENTROID_DTYPE, MessageError, ns_from_stamp, POINT_FIELD_TYPES, PREDICTION_DTYPE, read_cloud,
    STAR_DTYPE, TRACK_DTYPE)
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids, ROUND
from startracker_ros.centroid.prediction import PredictedStars
from startracker_ros.track.tracks import Tracks
from std_msgs.msg import Header

if TYPE_CHECKING:
    from startracker_ros.identify.identification import Identification


def cloud_to_message(rows: np.ndarray, header: Header) -> PointCloud2:
    """Return the cloud of structured rows (N,)."""
    fields = [PointField(name=name, offset=offset, count=1,
                         datatype=POINT_FIELD_TYPES[dtype.str[1:]])
              for name, (dtype, offset, *_) in (rows.dtype.fields or {}).items()]
    message = PointCloud2(header=header, height=1, width=len(rows), fields=fields,
                          is_bigendian=False, point_step=rows.dtype.itemsize,
                          row_step=rows.nbytes, is_dense=True)
    if len(rows):
        message.data.frombytes(rows.tobytes())
    return message


def _centroid_rows(dtype: np.dtype, uv: np.ndarray, flux: np.ndarray, snr: np.ndarray,
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
    rows = _centroid_rows(dtype, centroids.uv, centroids.flux, centroids.snr,
                          centroids.sigma_px, camera)
    # Zero is unknown: a sigma that is NaN is to be named by who needs it.
    covariance = np.nan_to_num(centroids.covariance, posinf=0.0)
    rows['cov_uu'], rows['cov_vv'] = covariance[:, 0, 0], covariance[:, 1, 1]
    rows['cov_uv'], rows['stamp_offset'] = covariance[:, 0, 1], centroids.delay_s
    common = centroids.common
    rows['common_uu'], rows['common_vv'] = common[:, 0, 0], common[:, 1, 1]
    rows['common_uv'] = common[:, 0, 1]
    return rows


def centroids_to_message(centroids: Centroids, camera: Camera, header: Header,
                         directed: bool = False) -> PointCloud2:
    """Return the `centroids` cloud; directed if only predicted stars were measured."""
    rows = _measured_rows(CENTROID_DTYPE, centroids, camera)
    rows['directed'] = directed
    return cloud_to_message(rows, header)


def centroids_from_rows(rows: np.ndarray) -> Centroids:
    """Return the centroids of `centroids` or `stars` rows."""
    known = rows['cov_uu'] > 0
    covariance, common = (
        np.stack([rows[name + end] for end in ('uu', 'uv', 'uv', 'vv')], -1).reshape(-1, 2, 2)
        for name in ('cov_', 'common_'))
    return Centroids(
        uv=np.stack([rows['u'], rows['v']], -1).astype(float), flux=rows['flux'].astype(float),
        snr=rows['snr'].astype(float), sigma_px=rows['sigma_px'].astype(float),
        covariance=covariance.astype(float) if known.all() else ROUND,
        delay_s=rows['stamp_offset'].astype(float), common=common.astype(float))


def centroids_from_message(message: PointCloud2) -> Centroids:
    """Return the centroids of a `centroids` cloud."""
    return centroids_from_rows(read_cloud(message, CENTROID_DTYPE))


def predictions_to_message(predicted: PredictedStars | None, header: Header) -> PointCloud2:
    """Return the `predicted_centroids` cloud, empty for None."""
    rows = np.zeros(0 if predicted is None else len(predicted), PREDICTION_DTYPE)
    if predicted is not None:
        rows['u'], rows['v'] = predicted.uv.T
        rows['u_rate'], rows['v_rate'] = predicted.velocity.T
        rows['sigma'], rows['hip'] = predicted.sigma_px, predicted.hip
    return cloud_to_message(rows, header)


def predictions_from_message(message: PointCloud2, camera: Camera) -> PredictedStars:
    """Return the stars of a `predicted_centroids` cloud; MessageError if of another camera."""
    rows = read_cloud(message, PREDICTION_DTYPE)
    uv = np.stack([rows['u'], rows['v']], -1).astype(float)
    inside = camera.contains(uv)
    if not inside.all():
        u, v = uv[~inside][0]
        raise MessageError(f'predicted star at u = {u:.1f}, v = {v:.1f} px is outside of the '
                           f'{camera.width} x {camera.height} px of camera_info: of another '
                           'camera?')
    if (rows['sigma'] < 0).any():
        raise MessageError('sigma of a predicted star is negative')
    return PredictedStars(
        ns_from_stamp(message.header.stamp), uv,
        np.stack([rows['u_rate'], rows['v_rate']], -1).astype(float),
        rows['sigma'].astype(float), rows['hip'].astype(np.int32))


def stars_to_message(centroids: Centroids, hip: np.ndarray, magnitude: np.ndarray,
                     residual_px: np.ndarray, camera: Camera, header: Header) -> PointCloud2:
    """Return the `stars` cloud of centroids with a catalogue number each, 0 for none."""
    rows = _measured_rows(STAR_DTYPE, centroids, camera)
    rows['hip'], rows['magnitude'], rows['residual_px'] = hip, magnitude, residual_px
    return cloud_to_message(rows, header)


def identification_to_message(centroids: Centroids, identification: 'Identification',
                              camera: Camera, header: Header) -> PointCloud2:
    """Return the `stars` cloud of an identified frame."""
    return stars_to_message(centroids, identification.hip, identification.magnitude,
                            identification.residual_px, camera, header)


def tracks_to_message(tracks: Tracks, camera: Camera, header: Header) -> PointCloud2:
    """Return the `tracks` cloud."""
    rows = _centroid_rows(TRACK_DTYPE, tracks.uv, tracks.flux, tracks.snr, tracks.sigma_px,
                          camera)
    for name in ('hip', 'magnitude', 'residual_px', 'track_id', 'age', 'missed',
                 'association_probability'):
        rows[name] = getattr(tracks, name)
    rows['u_rate'], rows['v_rate'] = tracks.velocity.T
    rows['cov_uu'], rows['cov_vv'] = tracks.covariance[:, 0, 0], tracks.covariance[:, 1, 1]
    rows['cov_uv'] = tracks.covariance[:, 0, 1]
    return cloud_to_message(rows, header)


def tracks_from_message(message: PointCloud2) -> Tracks:
    """Return the tracks of a `tracks` cloud."""
    rows = read_cloud(message, TRACK_DTYPE)
    covariance = np.stack([rows['cov_uu'], rows['cov_uv'], rows['cov_uv'], rows['cov_vv']], -1)
    columns = {name: rows[name].astype(float) for name in (
        'magnitude', 'flux', 'snr', 'sigma_px', 'residual_px', 'association_probability')}
    return Tracks(
        hip=rows['hip'].astype(np.int32),
        uv=np.stack([rows['u'], rows['v']], -1).astype(float),
        velocity=np.stack([rows['u_rate'], rows['v_rate']], -1).astype(float),
        covariance=covariance.reshape(-1, 2, 2).astype(float),
        track_id=rows['track_id'], age=rows['age'], missed=rows['missed'], **columns)
