"""Catalogue stars that no track follows yet, found among the centroids by the attitude."""

import numpy as np

from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.rotation import conjugate, rotate
from startracker_ros.track.motion_models import image_jacobian

GATE_SIGMA = 4.0
"""Below rotation_fit.OUTLIER_SIGMA, so that a star let in is not thrown out at once."""

MAX_DISTANCE_PX = 5.0
"""No star is looked for further away than this, however uncertain the attitude."""


def match_newcomers(camera: Camera, places: StarPlaces, attitude: AttitudeEstimate,
                    centroids: Centroids, sigma_px: np.ndarray, zero_point: float,
                    magnitude_tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (K,) of places and (K,) of centroids that belong to each other alone.

    sigma_px (M,) is the error of the centroids per axis; zero_point the magnitude of
    1 DN. A pair is taken when place and brightness agree and nothing else does for
    either of the two; a crowded star is no partner but makes others ambiguous.
    """
    boresight = rotate(attitude.quaternion, np.array([0.0, 0.0, 1.0]))
    near = places.within(boresight, camera.corner_angle_rad)
    sensor = rotate(conjugate(attitude.quaternion), places.direction[near])
    uv = camera.project(sensor)
    distance2 = np.sum((centroids.uv - uv[:, None]) ** 2, axis=-1)
    with np.errstate(invalid='ignore', divide='ignore'):
        magnitude = zero_point - 2.5 * np.log10(centroids.flux)
    alike = np.abs(magnitude - places.magnitude[near, None]) <= magnitude_tolerance
    # The covariance of the attitude is looked at only for stars that may matter.
    place, centroid = np.nonzero(alike & (distance2 < MAX_DISTANCE_PX ** 2))
    jacobian = image_jacobian(camera, sensor[place])
    shift = jacobian @ attitude.covariance_sensor @ np.swapaxes(jacobian, 1, 2)
    variance = sigma_px[centroid] ** 2 + np.trace(shift, axis1=1, axis2=2) / 2
    close = distance2[place, centroid] <= GATE_SIGMA ** 2 * variance
    place, centroid = place[close], centroid[close]
    alone = ((np.bincount(place, minlength=len(near))[place] == 1)
             & (np.bincount(centroid, minlength=len(centroids))[centroid] == 1)
             & ~places.crowded[near[place]])
    return near[place[alone]], centroid[alone]
