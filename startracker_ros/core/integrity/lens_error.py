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
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import LENS_ERROR
from startracker_ros.core.integrity.consistency import lens_sums, Residuals

MEMORY = 0.98  # of the sums of the frames before
_GATE = LENS_ERROR.threshold


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
        if len(star_index) < LENS_ERROR.limits['stars']:
            return False
        memory = self._memory = LensMemory(*add_residuals(
            self._memory, star_index, stars, self._axis_px, self.scale))
        scale = relative_scale(memory.outwards, memory.square)
        significant = memory.product > LENS_ERROR.sigmas * math.sqrt(memory.chance)
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


# --- the arithmetic of one frame: compiled ---


class LensMemory(NamedTuple):
    """
    Sums over the frames before, and the last frame.

    outwards and square as in LensSums; product, weight and chance are sums over pairs of
    residuals of a star in two frames in a row: of their weighted products, of the weighted share
    of the variance that they hold, and of the variance of the product by chance. star_index (K,),
    residual (K, 2) px and variance (K,) px^2 are those of the last frame.
    """

    outwards: float
    square: float
    product: float
    weight: float
    chance: float
    star_index: np.ndarray
    residual: np.ndarray
    variance: np.ndarray


@compiled
def relative_scale(outwards: float, square: float) -> float:
    """Return the scale k = d^T W r / d^T W d, zero where it is not significant."""
    return outwards / square if outwards ** 2 > _GATE * square else 0.0


@compiled
def add_residuals(memory: LensMemory, star_index: np.ndarray, stars: Residuals, axis: np.ndarray,
                  scale: float) -> LensMemory:
    """
    Return the memory after a frame of residuals of catalogue entries (K,), axis (2,) px.

    The residuals are those beside a scale, and outwards is that of all of it.
    Of a star in both frames the mean product of two axes, p = r_k . r_k-1 / 2, has the weight
    w = 1 / (v_k v_k-1), and by chance the variance w / 2 of w p.
    """
    sums = lens_sums(stars.uv, stars.residual, stars.error, stars.flow, axis)
    outwards = MEMORY * memory.outwards + sums.outwards + scale * sums.square
    square = MEMORY * memory.square + sums.square
    residual = sums.residual - (relative_scale(outwards, square) - scale) * sums.away
    product = weight = chance = 0.0
    pairs = 0
    for now in range(len(star_index)):
        for before in range(len(memory.star_index)):
            if star_index[now] != memory.star_index[before]:
                continue
            w = 1 / (sums.variance[now] * memory.variance[before])
            product += w * (residual[now, 0] * memory.residual[before, 0]
                            + residual[now, 1] * memory.residual[before, 1]) / 2
            weight += w * sums.left[now]
            chance += w / 2
            pairs += 1
    fade = MEMORY if pairs else 1.0
    return LensMemory(outwards, square, fade * memory.product + product,
                      fade * memory.weight + weight, fade ** 2 * memory.chance + chance,
                      star_index, residual, sums.variance)
