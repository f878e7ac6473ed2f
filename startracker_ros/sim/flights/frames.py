# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The centroids of many frames at once."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions, vantage_near_earth
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.io.bags.layouts import CENTROID_DTYPE
from startracker_ros.sim.flights.truth import Truth

_FLUX = 1e6


def centroid_frames(truth: Truth, onboard: OnboardCatalog, head: int, time_s: np.ndarray,
                    rng: np.random.Generator) -> list[np.ndarray]:
    """
    Return the rows of `centroids` of each frame at times (F,) in s, a minute or so, ascending.

    Stars are where an observer on the orbit sees them: within a minute the aberration is linear
    to 0.003 arcsec.
    """
    options, camera = truth.options, truth.camera
    quaternion = truth.attitude(head, time_s)
    matrix = matrix_from_quaternion(quaternion)
    middle = matrix[len(matrix) // 2, :, 2]
    travel = np.arccos(np.clip((matrix[:, :, 2] @ middle).min(), -1, 1))
    star = onboard.within(middle, camera.corner_angle_rad + travel + 1e-3)
    ends = [_apparent(truth, onboard.direction[star], at) for at in (time_s[0], time_s[-1])]
    part = (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9)
    direction = ends[0] + part[:, None, None] * (ends[1] - ends[0])
    centre = np.array([camera.cx, camera.cy])
    uv = camera.project(np.einsum('fji,fmj->fmi', matrix, direction))
    uv = centre + (uv - centre) * truth.focal_ratio(head, time_s)[:, None, None]
    magnitude = onboard.magnitude[star]
    parts = [_seen(truth, uv, np.broadcast_to(magnitude, uv.shape[:2]), rng)]
    objects = truth.objects(head).near(time_s[0], time_s[-1])
    hot_uv = truth.hot_pixels(head)
    # The SNR, 1 / sigma_px, falls as 10^(-0.2 magnitude).
    for uv, brightness in (
            (camera.project(np.einsum('fji,fmj->fmi', matrix, objects.at(time_s))),
             options.magnitude_limit - 5 * np.log10(options.object_snr * options.sigma_px)),
            (np.broadcast_to(hot_uv, (len(time_s), *hot_uv.shape)), options.magnitude_limit)):
        parts.append(_seen(truth, uv, np.full(uv.shape[:2], brightness), rng))
    false = rng.poisson(options.false, len(time_s))
    parts.append(_Spots(
        np.repeat(np.arange(len(time_s)), false),
        rng.uniform(0, options.width_px - 1, (false.sum(), 2)),
        rng.uniform(options.magnitude_limit - 2, options.magnitude_limit, false.sum()),
        np.full(false.sum(), options.sigma_px)))
    frame, uv, magnitude, sigma_px = map(np.concatenate, zip(*parts))
    order = np.lexsort((magnitude, frame))
    rows = _rows(truth, uv[order], magnitude[order], sigma_px[order])
    return np.split(rows, np.cumsum(np.bincount(frame, minlength=len(time_s)))[:-1])


class _Spots(NamedTuple):
    """Spots (N,): number of the frame, uv (N, 2), magnitude and sigma_px."""

    frame: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray
    sigma_px: np.ndarray


def _seen(truth: Truth, uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator
          ) -> _Spots:
    """Return what is seen at pixels (F, M, 2), of magnitude (F, M): most of it, with errors."""
    with np.errstate(invalid='ignore'):
        seen = truth.camera.contains(uv) & (rng.random(uv.shape[:2]) >= truth.options.missing)
    sigma_px = truth.options.centroid_sigma_px(magnitude[seen])
    return _Spots(
        np.nonzero(seen)[0], uv[seen] + rng.standard_normal((len(sigma_px), 2))
        * sigma_px[:, None], magnitude[seen] + rng.normal(0, 0.05, len(sigma_px)), sigma_px)


def _apparent(truth: Truth, direction: np.ndarray, time_s: float) -> np.ndarray:
    """Return where an observer on the orbit sees directions (N, 3) at a time."""
    year = epoch_year_from_stamp(int(truth.stamps_ns(np.array([time_s]))[0]))
    return apparent_directions(direction, vantage_near_earth(year, truth.orbit.at(time_s)[1]))


def _rows(truth: Truth, uv: np.ndarray, magnitude: np.ndarray, sigma_px: np.ndarray
          ) -> np.ndarray:
    rows = np.zeros(len(uv), CENTROID_DTYPE)
    for name, column in zip('xyz', truth.camera.unproject(uv).T):
        rows[name] = column
    rows['u'], rows['v'] = uv.T
    rows['flux'] = _FLUX * 10 ** (-0.4 * magnitude)
    rows['snr'], rows['sigma_px'] = 1 / sigma_px, sigma_px
    rows['cov_uu'] = rows['cov_vv'] = sigma_px ** 2
    return rows
