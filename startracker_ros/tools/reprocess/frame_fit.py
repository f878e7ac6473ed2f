# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars of one frame fitted by themselves: attitude, lens, residual of each star."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera


class Stars(NamedTuple):
    """Tracked stars: apparent direction (N, 3), uv (N, 2), sigma_px (N,), magnitude (N,)."""

    direction: np.ndarray
    uv: np.ndarray
    sigma_px: np.ndarray
    magnitude: np.ndarray


class FrameFit(NamedTuple):
    """
    What the centroids of one frame say without those before.

    star (K,) indexes the stars that have a centroid, magnitude (K,) is theirs. turn_rad (3,) about
    sensor axes from the tracked attitude to the best fit, covariance (3, 3). lens (5,) are the
    normal equations of changes f of the focal ratio and k of k1, the attitude eliminated: ff, fk,
    kk, f, k. residual (K, 2) rad to the east and north of each star, as the others see it, sigma
    (K,) rad.
    zero_point (K,) is V + 2.5 log10 flux, NaN where the flux is not positive; zero_point_mag is
    the median.
    """

    star: np.ndarray
    magnitude: np.ndarray
    turn_rad: np.ndarray
    covariance: np.ndarray
    lens: np.ndarray
    residual: np.ndarray
    sigma: np.ndarray
    zero_point: np.ndarray
    zero_point_mag: float


def fit_frame(camera: Camera, quaternion: np.ndarray, stars: Stars, uv: np.ndarray,
              sigma_px: np.ndarray, flux: np.ndarray) -> FrameFit | None:
    """
    Fit the stars that have one of the centroids uv (M, 2) near; None of fewer than four.

    Weighted least squares about an attitude (4,); native/src/ground_frame_fit.cpp has the
    equations.
    """
    lens, quaternion = camera.native, np.array(quaternion, float)
    columns = [np.ascontiguousarray(column, float) for column in stars[:3]]
    uv, sigma_px = (np.ascontiguousarray(column, float) for column in (uv, sigma_px))
    count = len(stars.uv)
    star, centroid = np.empty((2, count), np.int32)
    residual, sigma = np.empty((count, 2)), np.empty(count)
    fit = np.zeros((), native.FRAME_FIT)
    tracked = np.array((*(column.ctypes.data for column in columns), count, 0),
                       native.TRACKED_STARS)
    native.check(native.library().st_fit_frame(
        lens.ctypes.data, quaternion.ctypes.data, tracked.ctypes.data, uv.ctypes.data,
        sigma_px.ctypes.data, len(uv), fit.ctypes.data, star.ctypes.data, centroid.ctypes.data,
        residual.ctypes.data, sigma.ctypes.data))
    count = int(fit['stars'])
    if not count:
        return None
    magnitude, light = stars.magnitude[star[:count]], flux[centroid[:count]]
    with np.errstate(divide='ignore', invalid='ignore'):
        zero_point = magnitude + 2.5 * np.log10(np.where(light > 0, light, np.nan))
    # np.median() takes longer than the fit. NaN is sorted to the end.
    ordered = np.sort(zero_point).tolist()
    median = (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
    return FrameFit(star[:count], magnitude, fit['turn_rad'], fit['covariance_rad2'], fit['lens'],
                    residual[:count], sigma[:count], zero_point,
                    ordered[-1] if math.isnan(ordered[-1]) else median)
