# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The clouds `centroids`, `stars`, `truth/stars` and `tracks`: sensor_msgs/PointCloud2."""

from typing import TYPE_CHECKING

import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.core.astro.bodies import BODIES
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.cloud_rows import (
    centroid_rows, centroids_from_rows, star_rows, track_rows)
from startracker_ros.io.bags.layouts import (
    CENTROID_DTYPE, MessageError, ns_from_stamp, PREDICTION_DTYPE, read_cloud, TARGET_BODY,
    TRACK_DTYPE)
from startracker_ros.ros.messages.serialized import PassedMessage
from std_msgs.msg import Header

if TYPE_CHECKING:
    from startracker_ros.core.identify.identification import Identification


def cloud_to_message(rows: np.ndarray, header: Header) -> bytes:
    """Return the serialized cloud of structured rows (N,)."""
    return cdr.point_cloud(ns_from_stamp(header.stamp), header.frame_id, rows)


def centroids_to_message(centroids: Centroids, camera: Camera, header: Header,
                         windowed: bool = False) -> bytes:
    """Return the serialized `centroids` cloud; windowed if only predicted stars were measured."""
    return cloud_to_message(centroid_rows(centroids, camera, windowed), header)


def frame_from_message(message: PointCloud2) -> tuple[Centroids, bool]:
    """Return the centroids of a `centroids` cloud, and whether only predicted stars were seen."""
    if isinstance(message, PassedMessage):
        return message.value
    rows = read_cloud(message, CENTROID_DTYPE)
    return centroids_from_rows(rows), bool(rows['directed'].any())


def centroids_from_message(message: PointCloud2) -> Centroids:
    """Return the centroids of a `centroids` cloud."""
    return frame_from_message(message)[0]


def predictions_to_message(predicted: PredictedCentroids | None, header: Header,
                           bodies: tuple[BodyInImage, ...] = ()) -> bytes:
    """
    Return the serialized `predicted_centroids` cloud.

    It has stars and targets, none for None, and bodies.
    """
    count = 0 if predicted is None else len(predicted.hip)
    rows = np.zeros(count + len(bodies), PREDICTION_DTYPE)
    if predicted is not None:
        spots = rows[:count]
        spots['u'], spots['v'] = predicted.uv.T
        spots['u_rate'], spots['v_rate'] = predicted.velocity.T
        spots['sigma'], spots['hip'] = predicted.sigma_px, predicted.hip
        spots['body'][predicted.stars:] = TARGET_BODY
    for row, body in zip(rows[count:], bodies):
        row['u'], row['v'], row['sigma'] = body.u, body.v, body.radius_px
        row['body'] = BODIES.index(body.name) + 1
    return cloud_to_message(rows, header)


def bodies_from_message(message: PointCloud2) -> tuple[BodyInImage, ...]:
    """Return planets, Moon and Sun of a `predicted_centroids` cloud, of unknown magnitude."""
    if isinstance(message, PassedMessage):
        return message.value[1]
    rows = read_cloud(message, PREDICTION_DTYPE)
    return tuple(BodyInImage(BODIES[row['body'] - 1], float(row['u']), float(row['v']),
                             float('nan'), float(row['sigma']))
                 for row in rows[(rows['body'] > 0) & (rows['body'] <= len(BODIES))])


def predictions_from_message(message: PointCloud2, camera: Camera) -> PredictedCentroids:
    """
    Return the stars and targets of a `predicted_centroids` cloud.

    MessageError if they are of another camera.
    """
    predicted = (message.value[0] if isinstance(message, PassedMessage)
                 else _predictions_of(message))
    inside = camera.contains(predicted.uv)
    if not inside.all():
        u, v = predicted.uv[~inside][0]
        raise MessageError(f'predicted centroid at u = {u:.1f}, v = {v:.1f} px is outside of the '
                           f'{camera.width} x {camera.height} px of camera_info: of another '
                           'camera?')
    return predicted


def _predictions_of(message: PointCloud2) -> PredictedCentroids:
    rows = read_cloud(message, PREDICTION_DTYPE)
    stars, targets = rows[rows['body'] == 0], rows[rows['body'] == TARGET_BODY]
    rows = np.concatenate([stars, targets])
    if (rows['sigma'] < 0).any():
        raise MessageError('sigma of a predicted centroid is negative')
    return PredictedCentroids(
        ns_from_stamp(message.header.stamp), np.stack([rows['u'], rows['v']], -1).astype(float),
        np.stack([rows['u_rate'], rows['v_rate']], -1).astype(float),
        rows['sigma'].astype(float), rows['hip'].astype(np.int32), len(stars))


def stars_to_message(centroids: Centroids, hip: np.ndarray, magnitude: np.ndarray,
                     residual_px: np.ndarray, camera: Camera, header: Header) -> bytes:
    """Return the serialized `stars` cloud of centroids with a catalogue number each or 0."""
    return cloud_to_message(star_rows(centroids, hip, magnitude, residual_px, camera), header)


def identification_to_message(centroids: Centroids, identification: 'Identification',
                              camera: Camera, header: Header) -> bytes:
    """Return the serialized `stars` cloud of an identified frame."""
    return stars_to_message(centroids, identification.hip, identification.magnitude,
                            identification.residual_px, camera, header)


def tracks_to_message(tracks: Tracks, camera: Camera, header: Header) -> bytes:
    """Return the serialized `tracks` cloud."""
    return cloud_to_message(track_rows(tracks, camera), header)


def tracks_from_message(message: PointCloud2) -> Tracks:
    """Return the tracks of a `tracks` cloud."""
    if isinstance(message, PassedMessage):
        return message.value
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
