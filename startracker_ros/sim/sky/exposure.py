# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Paths of the light sources over the pixels during an exposure."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import attitude_error, matrix_from_quaternion
from startracker_ros.sim.sky.motion_state import Motion
from startracker_ros.sim.sky.shake import ShakenMotion, uneven_instants
from startracker_ros.sim.sky.sources import LightSources

# The iteration for the row of a star ends below this change or after _ROW_STEPS.
_ROW_TOLERANCE_PX = 1e-4
_ROW_STEPS = 10
# From row to row a body turns by a polynomial through this many attitudes, at Chebyshev points.
_ROW_ATTITUDES = 5


def project_visible(camera: Camera, sensor: np.ndarray, margin_px: float) -> np.ndarray:
    """Return pixels (N, 2) of vectors (N, 3) on sensor axes; NaN far outside the image."""
    # The distortion model is not valid far outside the field. Twice the nominal angle of the
    # margin allows for distortion.
    radius_rad = min(camera.corner_angle_rad + 2 * margin_px * camera.pixel_rad, np.pi)
    near = sensor[:, 2] >= np.cos(radius_rad) * np.linalg.norm(sensor, axis=-1)
    uv = np.full((len(sensor), 2), np.nan)
    uv[near] = camera.project(sensor[near])
    return uv


def image_paths(camera: Camera, motion: Motion, sources: LightSources, time_s: float, *,
                exposure_s: float, step_px: float, line_time_s: float,
                margin_px: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return pixels (K, N, 2) at K instants of the exposure, and the weight (K,) of each.

    K is odd and instant K // 2 is the middle of the exposure. time_s is the time of the image:
    with a rolling shutter, of its middle row; line_time_s is negative if rows are exposed
    upwards. Instants and weights are those of Gauss-Legendre
    quadrature; with step_px equal to the sigma of the PSF the streak is exact to 0.1 %. Those of
    a shaken motion have equal weights, 1.5 % of the exposure each.
    """
    speed_px_s = _speed_px_s(camera, motion, sources, time_s)
    if isinstance(motion, ShakenMotion) and exposure_s:
        instants_s, weight = uneven_instants(exposure_s)
        margin_px = margin_px + 2 * motion.reach_rad / camera.pixel_rad
    else:
        instants_s, weight = _instants(exposure_s, speed_px_s * exposure_s / step_px)
    # Includes stars that enter the field before the last row is exposed.
    margin_px = margin_px + speed_px_s * abs(line_time_s) * camera.height / 2
    paths = np.empty((len(instants_s), len(sources.hip), 2))
    for path, instant_s in zip(paths, instants_s):
        state = motion.at(time_s + instant_s)
        matrix = matrix_from_quaternion(state.q_icrf_from_sensor)
        sensor = (sources.direction + instant_s * sources.drift_rad_s) @ matrix
        path[:] = project_visible(camera, sensor, margin_px)
        if line_time_s:
            path[:] = _rolling_shutter(
                camera, sensor, sources.drift_rad_s @ matrix,
                _turn_in(motion, state.q_icrf_from_sensor, time_s + instant_s,
                         abs(line_time_s) * (camera.height / 2 + margin_px)),
                path, line_time_s, margin_px)
    return paths, weight


def _turn_in(motion: Motion, q: np.ndarray, time_s: float, reach_s: float
             ) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives the turn (N, 3) from q at a time, at delays (N,) of up to reach_s."""
    def turns(shares: np.ndarray) -> Any:
        return np.array([
            attitude_error(motion.at(time_s + share * reach_s).q_icrf_from_sensor, q)
            for share in shares])
    coefficients = np.polynomial.chebyshev.chebinterpolate(turns, _ROW_ATTITUDES - 1)
    return lambda delay_s: np.polynomial.chebyshev.chebval(delay_s / reach_s, coefficients).T


def _rolling_shutter(camera: Camera, sensor: np.ndarray, drift_rad_s: np.ndarray,
                     turn_in: Callable[[np.ndarray], np.ndarray], uv: np.ndarray,
                     line_time_s: float, margin_px: float) -> np.ndarray:
    """
    Return pixels (N, 2) of vectors on sensor axes, each at the time of its own row.

    uv (N, 2) are those at the time of the middle row. The sensor turns by turn_in() and
    the sources drift (N, 3). The row of a star depends on its pixel: fixed-point iteration.
    """
    for _ in range(_ROW_STEPS):
        delay_s = (uv[:, 1] - (camera.height - 1) / 2) * line_time_s
        moved, turn = sensor + delay_s[:, None] * drift_rad_s, turn_in(delay_s)
        # Rodrigues' formula; the vectors rotate against the sensor.
        angle = np.linalg.norm(turn, axis=1, keepdims=True) / np.pi
        across = np.cross(turn, moved)
        rotated = (moved - np.sinc(angle) * across
                   + np.sinc(angle / 2) ** 2 / 2 * np.cross(turn, across))
        before, uv = uv, project_visible(camera, rotated, margin_px)
        if not (np.abs(uv - before) > _ROW_TOLERANCE_PX).any():
            break
    return uv


def _speed_px_s(camera: Camera, motion: Motion, sources: LightSources,
                time_s: float) -> float:
    """Return an upper bound of the speed of the sources anywhere in the field."""
    x, y, z = motion.at(time_s).rate_rad_s
    corner = camera.radius(camera.corner_angle_rad)
    # How much more a turn across the boresight moves stars in the corner than in the middle.
    stretch = (corner / np.sin(corner) if camera.model.equidistant else 1 + corner ** 2)
    drift = np.linalg.norm(sources.drift_rad_s, axis=-1).max(initial=0.0)
    return ((np.hypot(x, y) + drift) * stretch + abs(z) * corner) / camera.pixel_rad


def _instants(exposure_s: float, steps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the instants (K,) in s from the middle of the exposure and their weights (K,)."""
    node, weight = _legendre(2 * int(np.ceil(steps / 2)) + 1)
    return node * exposure_s / 2, weight / 2


@lru_cache(maxsize=8)
def _legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)
