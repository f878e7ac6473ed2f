# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors of star positions that stay from frame to frame, measured by the residuals.

A lens that is not quite the camera model, coma, or an image that is no Gaussian moves a star by
nearly the same in the next frame. A filter averages noise over frames, but not these. Where all
noise is white the residuals of the filter are white as well: the mean product of a star's
residuals in two frames in a row is the variance of what stays. A rotation of all stars is taken
out before, being no matter of the lens; it takes a share of the stars' own errors with it.

Part of what stays may be a scale: a wrong focal length, or the tails of coma, which all point away
from the axis. Such errors do not average out over stars whose mean position is not the axis. The
scale k, r = k d for residuals r at d from the axis, is fitted to all frames, and the next ones are
predicted with it: the focal length is 1 + k times as long. The errors that stay are those beside
it.
"""

import math

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.track.consistency import Residuals
from startracker_ros.core.track.followed_stars import (
    add_residuals, LensMemory, relative_scale, SIGNIFICANT)

LEAST_STARS = 6


class LensError:
    """
    Learns the error that stays, from good frames in turn.

    value_px is its sigma per axis, beside that of scale, the relative error of the distance of
    stars from the axis; both are zero where they are not significant. lens is that of the camera
    with this scale, and scale_sigma the error of the scale, zero without any.
    """

    def __init__(self, camera: Camera) -> None:
        self._axis_px = np.array([camera.cx, camera.cy])
        self._camera, self.lens = camera, camera.lens
        self.value_px = self.scale = self.scale_sigma = 0.0
        self._memory = LensMemory(0.0, 0.0, 0.0, 0.0, 0.0, np.empty(0, np.int64),
                                  np.empty((0, 2)), np.empty(0))

    def add(self, star_index: np.ndarray, stars: Residuals) -> bool:
        """
        Add the residuals of a frame, of catalogue entries (K,), that lens has predicted.

        Return whether lens has a scale for the first time.
        """
        if len(star_index) < LEAST_STARS:
            return False
        memory = self._memory = LensMemory(*add_residuals(
            self._memory, star_index, stars, self._axis_px, self.scale))
        scale = relative_scale(memory.outwards, memory.square)
        significant = memory.product > SIGNIFICANT * math.sqrt(memory.chance)
        self.value_px = math.sqrt(memory.product / memory.weight) if significant else 0.0
        # The attitude of this frame is by the scale of the one before.
        self.scale_sigma = math.hypot(scale - self.scale,
                                      1 / math.sqrt(memory.square) if scale else 0.0)
        if scale == self.scale:
            return False
        first, lens = not self.scale, self._camera.lens
        self.scale, self.lens = scale, lens._replace(
            fx=(1 + scale) * lens.fx, fy=(1 + scale) * lens.fy)
        return first
