# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The fit of a lens to one image, by the native library.

native/src/blind/lens_fit.h tells the parameters d, a, b, g, h, k that change a lens, lens_growth.h
how an unknown one is grown. A lens here is an st_fitted_lens: a camera, an attitude and the
covariance of the parameters.
"""

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.distortion import MODELS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector

_FOCAL, RADIAL = 3, 7  # where a is, and where k begins
LEAST_ERROR_PX = 0.1
_HORIZON_SQUARE = (np.pi / 2) ** 2
_UNLIKE = 0.02
FISHEYE_TERMS = (0.06, *(_UNLIKE / _HORIZON_SQUARE ** n for n in (2, 3, 4)))
"""
Prior standard deviations of k1 to k4 of a fisheye, k2 to k4 about a projection.

Each moves the horizon by 2 %. Of 35 fits of fisheyes in Lensfun (2026), to 48 to 90 deg, half of
these terms are below 1.5 %, and three lenses of action cameras above 10 %.
"""


def lens_of(camera: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return the lens of an st_camera with an attitude (4,)."""
    lens = np.zeros((), native.FITTED_LENS)
    lens['camera'], lens['quaternion'] = camera, quaternion
    return lens


def camera_of(lens: np.ndarray, model: str) -> Camera:
    """Return the camera of a lens of a distortion model; CameraError for none."""
    width, height, fx, fy, cx, cy, terms = lens['camera'].item()[:7]
    count = len(MODELS[model].coefficients)
    return Camera(width, height, fx, fy, cx, cy, tuple(terms[:count].tolist()), model)


def changed(lens: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return a lens with its parameters changed by change (P,)."""
    other, (a, b, g, h) = lens.copy(), change[3:RADIAL]
    camera = other['camera']
    camera['fx_px'] *= np.exp(a)
    camera['fy_px'] *= np.exp(a + b)
    camera['cx_px'] += camera['width_px'] * g
    camera['cy_px'] += camera['width_px'] * h
    camera['distortion'][:len(change) - RADIAL] += change[RADIAL:]
    other['quaternion'] = multiply(
        lens['quaternion'], quaternion_from_rotation_vector(change[:3]))
    return other


class LensError:
    """
    The error that a fitted lens has at each pixel.

    covariance (P, P) is that of its parameters; those of the focal length and of the radial terms
    move the pixel of a star at a distance from the axis.
    """

    def __init__(self, camera: Camera, covariance: np.ndarray) -> None:
        used = [_FOCAL, *range(RADIAL, len(covariance))]
        self._camera, self._covariance = camera, covariance[np.ix_(used, used)]

    def sigma_px(self, uv: np.ndarray) -> np.ndarray:
        """Return the standard deviations (N,) of the radii of pixels (N, 2); NaN for no star."""
        camera = self._camera
        theta = np.arccos(np.clip(camera.unproject(uv)[:, 2], -1, 1))
        plane = theta if camera.model.equidistant else np.tan(theta)
        terms = np.arange(1, len(self._covariance))
        partial = np.column_stack([
            np.hypot(*((uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy)).T),
            plane[:, None] ** (2 * terms + 1)])
        return camera.fx * np.sqrt(np.einsum('ni,ij,nj->n', partial, self._covariance, partial))

    def relative(self, uv: np.ndarray) -> np.ndarray:
        """Return the errors (N,) of the angles to the axis as shares of them; NaN for no star."""
        camera = self._camera
        outwards = uv - (camera.cx, camera.cy)
        outwards /= np.hypot(*outwards.T)[:, None]
        angle, farther = (np.arccos(np.clip(camera.unproject(pixel)[:, 2], -1, 1)) for pixel in (
            uv, uv + self.sigma_px(uv)[:, None] * outwards))
        return farther / angle - 1


class SkyAndSpots:
    """Stars of directions (S, 3) in ICRF and spots uv (N, 2) px of errors sigma_px (N,)."""

    def __init__(self, direction: np.ndarray, uv: np.ndarray, sigma_px: np.ndarray) -> None:
        self._arrays = [np.ascontiguousarray(array, float) for array in (direction, uv, sigma_px)]
        self._native = np.array((*(array.ctypes.data for array in self._arrays), len(direction),
                                 len(uv)), native.SKY_AND_SPOTS)
        self._work = np.empty(512 + 32 * len(uv), np.uint8)

    def fitted(self, lens: np.ndarray, start: np.ndarray, free: np.ndarray, star: np.ndarray
               ) -> np.ndarray:
        """
        Return a lens fitted to the spots whose stars are known: star (N,), -1 for none.

        free (P,) are the prior standard deviations of the parameters about those of the st_camera
        start.
        """
        found = lens.copy()
        native.call('st_fit_lens', _prior(start, free), self._native, star.astype(np.int32),
                    found, self._work, len(self._work))
        return found

    def gated(self, lens: np.ndarray, parameters: int, error_px: float) -> np.ndarray:
        """Return the star (N,) in whose gate each spot is, one to one, -1 for none."""
        star = np.empty(len(self._arrays[1]), np.int32)
        native.call('st_gated_stars', lens, parameters, error_px, self._native, star, self._work,
                    len(self._work))
        return star.astype(int)

    def grown(self, start: np.ndarray, free: np.ndarray, spot: np.ndarray, star: np.ndarray,
              ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the most probable of the lenses that are grown from candidates, and stars (N,).

        Spots spot (K, 4) are taken for the stars star (K, 4), and the focal length is that of the
        st_camera start over ratio (K,). Its probability is that its matches are chance.
        """
        found = np.zeros((), native.FITTED_LENS)
        matched = np.empty(len(self._arrays[1]), np.int32)
        native.call('st_grow_lens', _prior(start, free), self._native, *(
            np.ascontiguousarray(array, kind) for array, kind in (
                (spot, np.int32), (star, np.int32), (ratio, float))), len(spot), found, matched,
            self._work, len(self._work))
        return found, matched.astype(int)


def _prior(start: np.ndarray, free: np.ndarray) -> np.ndarray:
    prior = np.zeros((), native.LENS_PRIOR)
    prior['start'], prior['parameters'] = start, len(free)
    prior['free'][:len(free)] = free
    return prior


def stars_in_image(lens: np.ndarray, icrf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices (M,) of the directions (N, 3) in the image, and pixels (M, 2)."""
    index, pixel = np.empty(len(icrf), np.int32), np.empty((len(icrf), 2))
    count = np.zeros(1, np.uintp)
    native.call('st_stars_in_image', lens['camera'], lens['quaternion'],
                np.ascontiguousarray(icrf, float), len(icrf), index, pixel, count)
    found = slice(int(count[0]))
    return index[found].astype(int), pixel[found].copy()
