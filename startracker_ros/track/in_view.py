"""Which catalogue stars an attitude puts into the image, and where: compiled."""

import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera.lens import Lens, project
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.compiled import compiled
from startracker_ros.maths.rotation import matrix_from_quaternion

AHEAD_RAD = np.radians(0.5)
"""Margin around the image of the cached stars, so that most frames need no catalogue search."""


class StarsInView:
    """The catalogue stars of a camera around attitudes that change little from one to the next."""

    def __init__(self, camera: Camera, sky: ApparentCatalog) -> None:
        self.camera = camera
        self.sky = sky
        self.onboard = sky.onboard
        self._version = -1
        self._centre = np.zeros(3)
        self._cos_ahead = float(np.cos(AHEAD_RAD))
        self._cos_radius = float(np.cos(camera.corner_angle_rad))

    def of(self, attitude: AttitudeEstimate, most: int | None = None
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return catalogue indices (M,), brightest first, directions (M, 3) and pixels (M, 2).

        Directions are on sensor axes. The stars are those of the cone around the image, or those
        among the brightest of that cone and its surroundings.
        """
        matrix, near = self._around(attitude), self._near
        if most is not None:
            near = near[:most]
            direction = self.sky.direction(near)
        else:
            if self._version != self.sky.version:
                self._version, self._direction = self.sky.version, self.sky.direction(near)
            direction = self._direction
        return _in_view(near, direction, matrix, self._cos_radius, self.camera.lens)

    def bright(self, attitude: AttitudeEstimate, faintest: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return catalogue indices (M,) up to a magnitude, in and near the image, brightest first.

        With their directions (M, 3) on ICRF axes, and the matrix (3, 3) of the attitude.
        """
        matrix = self._around(attitude)
        near = self._near[:np.searchsorted(self._magnitude, faintest, side='right')]
        return near, self.sky.direction(near), matrix

    def _around(self, attitude: AttitudeEstimate) -> np.ndarray:
        """Find the stars in and near the image; return the matrix (3, 3) of the attitude."""
        matrix = matrix_from_quaternion(attitude.quaternion)
        boresight = matrix[:, 2]
        if not boresight @ self._centre > self._cos_ahead:
            self._centre = boresight
            self._near = self.onboard.within(boresight, self.camera.corner_angle_rad + AHEAD_RAD)
            self._magnitude = self.onboard.magnitude[self._near]
            self._version = -1
        return matrix


@compiled
def _in_view(near: np.ndarray, direction: np.ndarray, matrix: np.ndarray, cos_radius: float,
             lens: Lens) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stars near (N,), of direction (N, 3), in the cone, as StarsInView.of does."""
    count = 0
    index = np.empty(len(near), np.int64)
    sensor = np.empty((len(near), 3))
    for i in range(len(near)):
        x, y, z = direction[i, 0], direction[i, 1], direction[i, 2]
        ahead = x * matrix[0, 2] + y * matrix[1, 2] + z * matrix[2, 2]
        if ahead >= cos_radius:
            index[count] = near[i]
            sensor[count, 0] = x * matrix[0, 0] + y * matrix[1, 0] + z * matrix[2, 0]
            sensor[count, 1] = x * matrix[0, 1] + y * matrix[1, 1] + z * matrix[2, 1]
            sensor[count, 2] = ahead
            count += 1
    return index[:count], sensor[:count], project(lens, sensor[:count])
