"""Where each light source stands in the image while the shutter is open."""

from functools import lru_cache

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import matrix_from_quaternion
from startracker_ros.sky.motion import Motion
from startracker_ros.sky.sources import LightSources

# The row in which a star is read is sought until it stands as still as this, or so often.
_STILL_PX = 1e-4
_ROW_STEPS = 10


def image_places(camera: Camera, sensor: np.ndarray, margin_px: float) -> np.ndarray:
    """Return pixels (N, 2) of vectors (N, 3) on sensor axes; NaN far outside the image."""
    # Only what is near the field is projected: the distortion model means nothing elsewhere.
    # Twice the nominal angle of the margin leaves room for distortion.
    radius_rad = camera.corner_angle_rad + 2 * margin_px * camera.pixel_rad
    near = sensor[:, 2] >= np.cos(radius_rad) * np.linalg.norm(sensor, axis=-1)
    places = np.full((len(sensor), 2), np.nan)
    places[near] = camera.project(sensor[near])
    return places


def image_paths(camera: Camera, motion: Motion, sources: LightSources, time_s: float, *,
                exposure_s: float, step_px: float, line_time_s: float,
                margin_px: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return pixels (K, N, 2) at K instants of the exposure, and the weight (K,) of each.

    The middle one of the K, an odd number, is the middle of the exposure. time_s is that of
    the image: with a rolling shutter, that of its middle row. Weights and instants are those
    of Gauss and Legendre, which at step_px of a Gaussian sigma give the streak to 0.1 %.
    """
    speed_px_s = _speed_px_s(camera, motion, sources, time_s)
    instants_s, weight = _instants(exposure_s, speed_px_s * exposure_s / step_px)
    # Room for what comes into view while the first or the last row waits for its turn.
    margin_px = margin_px + speed_px_s * line_time_s * camera.height / 2
    paths = np.empty((len(instants_s), len(sources.hip), 2))
    for path, instant_s in zip(paths, instants_s):
        state = motion.at(time_s + instant_s)
        matrix = matrix_from_quaternion(state.q_icrf_from_sensor)
        sensor = (sources.direction + instant_s * sources.drift_rad_s) @ matrix
        path[:] = image_places(camera, sensor, margin_px)
        if line_time_s:
            path[:] = _rows_in_turn(camera, sensor, sources.drift_rad_s @ matrix,
                                    state.rate_rad_s, path, line_time_s, margin_px)
    return paths, weight


def _rows_in_turn(camera: Camera, sensor: np.ndarray, drift_rad_s: np.ndarray,
                  rate_rad_s: np.ndarray, places: np.ndarray, line_time_s: float,
                  margin_px: float) -> np.ndarray:
    """
    Return pixels (N, 2) of vectors on sensor axes, each at the time of its own row.

    places (N, 2) are those at the time of the middle row; while a row waits for its turn the
    sensor turns at rate_rad_s (3,) and the sources drift (N, 3).
    """
    x, y, z = rate_rad_s
    cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    speed_rad_s = np.linalg.norm(rate_rad_s)
    for _ in range(_ROW_STEPS):
        delay_s = ((places[:, 1] - (camera.height - 1) / 2) * line_time_s)[:, None]
        moved = sensor + delay_s * drift_rad_s
        # Rodrigues: the vectors turn against the sensor.
        angle = speed_rad_s * delay_s / np.pi
        across = delay_s * (moved @ cross)
        turned = (moved - np.sinc(angle) * across
                  + np.sinc(angle / 2) ** 2 / 2 * delay_s * (across @ cross))
        before, places = places, image_places(camera, turned, margin_px)
        if not (np.abs(places - before) > _STILL_PX).any():
            break
    return places


def _speed_px_s(camera: Camera, motion: Motion, sources: LightSources,
                time_s: float) -> float:
    """Return how many pixels a second a source moves at most, anywhere in the field."""
    x, y, z = motion.at(time_s).rate_rad_s
    corner = np.tan(camera.corner_angle_rad)
    drift = np.linalg.norm(sources.drift_rad_s, axis=-1).max(initial=0.0)
    return ((np.hypot(x, y) + drift) * (1 + corner ** 2) + abs(z) * corner) / camera.pixel_rad


def _instants(exposure_s: float, steps: float) -> tuple[np.ndarray, np.ndarray]:
    node, weight = _legendre(2 * int(np.ceil(steps / 2)) + 1)
    return node * exposure_s / 2, weight / 2


@lru_cache(maxsize=8)
def _legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)
