"""
Errors of star positions that stay from frame to frame, measured by the residuals.

A lens that is not quite the camera model, coma, or an image that is no Gaussian moves a star by
nearly the same in the next frame. A filter averages noise over frames, but not these. Where all
noise is white the residuals of the filter are white as well: the mean product of a star's
residuals in two frames in a row is the variance of what stays. A rotation of all stars is taken
out before, being no matter of the lens; it takes a share of the stars' own errors with it.

Part of what stays may be a scale: a wrong focal length, or the tails of coma, which all point away
from the axis. Such errors do not average out over stars whose mean position is not the axis. The
scale k, r = k d for residuals r at d from the axis, is fitted to all frames; the errors that stay
are those beside it.
"""

import math

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.track.consistency import Residuals
from startracker_ros.track.residual_columns import lens_sums

MEMORY = 0.98  # of the products of the frames before
SIGNIFICANT = 4.0  # standard deviations of their mean by chance
LEAST_STARS = 6


class LensError:
    """
    Learns the error that stays, from good frames in turn.

    value_px is its sigma per axis, beside that of scale, the relative error of the distance of
    stars from the axis; both are zero where they are not significant.
    """

    def __init__(self, camera: Camera) -> None:
        self._axis_px = np.array([camera.cx, camera.cy])
        self.value_px = self.scale = 0.0
        self._outwards = self._square = 0.0
        self._star_index = np.empty(0, np.int64)
        self._residual, self._variance = np.empty((0, 2)), np.empty(0)
        self._product = self._weight = self._chance = 0.0

    def add(self, star_index: np.ndarray, stars: Residuals) -> None:
        """Add the residuals of a frame, of catalogue entries (K,)."""
        if len(star_index) < LEAST_STARS:
            return
        sums = lens_sums(stars.uv, stars.residual, stars.error, stars.flow, self._axis_px)
        self._outwards = MEMORY * self._outwards + sums.outwards
        self._square = MEMORY * self._square + sums.square
        significant = self._outwards ** 2 > SIGNIFICANT ** 2 * self._square
        self.scale = self._outwards / self._square if significant else 0.0
        residual, variance = sums.residual - self.scale * sums.away, sums.variance
        now, before = np.nonzero(star_index[:, None] == self._star_index)
        if len(now):
            # The mean of two products, one of each axis, has half the variance of one.
            weight = 1 / (variance[now] * self._variance[before])
            product = (residual[now] * self._residual[before]).sum(axis=1) / 2
            self._product = MEMORY * self._product + float(weight @ product)
            self._weight = MEMORY * self._weight + float(weight @ sums.left[now])
            self._chance = MEMORY ** 2 * self._chance + float(weight.sum()) / 2
            significant = self._product > SIGNIFICANT * math.sqrt(self._chance)
            self.value_px = math.sqrt(self._product / self._weight) if significant else 0.0
        self._star_index, self._residual, self._variance = star_index, residual, variance
