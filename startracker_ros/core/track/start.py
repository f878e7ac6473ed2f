# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a model of the motion of stars starts with: two identified frames, or one and a hint."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.error_ellipses import fit_error_ellipses
from startracker_ros.core.attitude.estimate import AttitudeError, AttitudeEstimate
from startracker_ros.core.attitude.result import with_correlated_error
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.integrity.checks import (
    HINT, HINT_DIFFERS, HINT_FAILED, IDENTIFICATION_DIFFERS, MISFIT)
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.rotation import attitude_error, conjugate, rotate
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rotation_fit import fit_rotation
from startracker_ros.core.track.tracks import Hint

# --- identified frames: their attitude, and whether it contradicts that of the tracks ---


@dataclass(frozen=True)
class IdentifiedFrame:
    """
    A frame that fits the catalogue: star_index (N,), centroids of N stars, and the attitude.

    scale is that of RotationFit.
    """

    stamp_ns: int
    star_index: np.ndarray
    centroids: Centroids
    attitude: AttitudeEstimate
    scale: float

    def contradicts(self, tracked: AttitudeEstimate, camera: Camera, sky: ApparentCatalog,
                    max_residual_px: float) -> bool:
        """
        Return whether a tracked attitude of the same frame is too far from this one.

        In sigma and in pixels: a small sigma alone, or a poor lens alone, is no contradiction.
        """
        error = attitude_error(self.attitude.quaternion, tracked.quaternion)
        covariance = self.attitude.covariance_sensor + tracked.covariance_sensor
        distance2 = error @ np.linalg.solve(covariance, error)
        sensor = rotate(conjugate(tracked.quaternion), sky.direction(self.star_index))
        residual = camera.project(sensor) - self.centroids.uv
        rms_px = np.sqrt(np.mean(np.sum(residual ** 2, axis=1)))
        check = IDENTIFICATION_DIFFERS
        return bool(distance2 > check.threshold
                    and not rms_px <= check.limits['residual_ratio'] * max_residual_px)


def fit_identified(camera: Camera, sky: ApparentCatalog, options: TrackerOptions, stamp_ns: int,
                   centroids: Centroids, error_px2: np.ndarray, hip: np.ndarray
                   ) -> tuple[IdentifiedFrame | None, str]:
    """
    Return an identified frame without outliers, None unless enough stars fit well enough.

    The second result is why the stars do not fit, empty if they do or are too few.

    error_px2 (N, 2, 2) and hip (N,) are of each centroid, hip is 0 where it is unknown. Crowded
    stars are left out. Of several centroids with one hip the first, the brightest, counts.
    """
    star_index = sky.onboard.index_of(hip)
    known = (star_index >= 0) & ~sky.crowded(star_index)
    known[known] = _first_of_each(star_index[known])
    centroids, error_px2, star_index = (
        centroids.select(known), error_px2[known], star_index[known])
    if len(star_index) < options.min_stars:
        return None, ''
    try:
        fit = fit_rotation(camera, sky.direction(star_index), centroids.uv,
                           np.sqrt(np.trace(error_px2, axis1=1, axis2=2) / 2),
                           np.ones(len(star_index), bool))
    except AttitudeError:
        return None, ''
    if not fit.is_good(len(star_index), options.min_stars, options.max_residual_px):
        if not fit.residual_px > options.max_residual_px:
            return None, ''
        return None, MISFIT.diagnostic.format(
            stars=len(star_index), residual_px=fit.residual_px, limit=options.max_residual_px)
    star_index, centroids = star_index[fit.inlier], centroids.select(fit.inlier)
    attitude = fit_error_ellipses(
        fit.attitude, camera, centroids.uv, sky.direction(star_index), error_px2[fit.inlier])
    return IdentifiedFrame(
        stamp_ns, star_index, centroids,
        with_correlated_error(attitude, centroids.correlated_error, camera), fit.scale), ''


def _first_of_each(values: np.ndarray) -> np.ndarray:
    """Return True (N,) at the first occurrence of each value."""
    if len(set(values.tolist())) == len(values):
        return np.ones(len(values), bool)
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first


# --- starts ---

_MAX_SIGMA_RAD = np.radians(HINT.limits['sigma_deg'])
_MAX_RATE_SIGMA_RAD_S = np.radians(HINT.limits['rate_sigma_deg_s'])
_RATE_FLOOR_RAD_S = np.radians(0.05)


class Start(NamedTuple):
    """
    An identified frame with the body rate (3,) rad/s and its covariance (3, 3).

    cross (3, 3) is the covariance of attitude and rate error; reason is for tracker_state; hinted
    is whether the rate is that of a hint.
    """

    frame: IdentifiedFrame
    rate: np.ndarray
    rate_covariance: np.ndarray
    cross: np.ndarray
    reason: str
    hinted: bool = False


def start_of_two(first: IdentifiedFrame, second: IdentifiedFrame) -> Start:
    """Return the start at the second of two frames."""
    dt_s = (second.stamp_ns - first.stamp_ns) * 1e-9
    attitude = second.attitude.covariance_sensor * second.scale ** 2
    before = first.attitude.covariance_sensor * first.scale ** 2
    rate = rotation_between(first.attitude.quaternion, second.attitude.quaternion) / dt_s
    return Start(second, rate, (attitude + before) / dt_s ** 2, attitude / dt_s,
                 f'{len(second.star_index)} stars identified twice')


def start_of_prediction(predicted: Hint, frame: IdentifiedFrame) -> Start | None:
    """Return the start at a frame of stars where tracks predicted them; None if they differ."""
    return _confirmed(predicted, frame, 'where the tracks before had them', hinted=False)


def _confirmed(hint: Hint, frame: IdentifiedFrame, where: str, *, hinted: bool) -> Start | None:
    """Return the start at a frame that agrees with an attitude; None without one."""
    dt_s = (frame.stamp_ns - hint.stamp_ns) * 1e-9
    floor_rad_s = _RATE_FLOOR_RAD_S if hinted else 0.0
    rate_covariance = hint.rate_covariance + floor_rad_s ** 2 * np.eye(3)
    if not (_is_within(hint.covariance, _MAX_SIGMA_RAD)
            and _is_within(hint.rate_covariance, _MAX_RATE_SIGMA_RAD_S)):
        return None
    innovation = rotation_between(
        turned(hint.quaternion, hint.rate * dt_s), frame.attitude.quaternion)
    S = (hint.covariance + frame.attitude.covariance_sensor * frame.scale ** 2
         + rate_covariance * dt_s ** 2)
    if innovation @ np.linalg.solve(S, innovation) > HINT_DIFFERS.threshold:
        return None
    return Start(frame, hint.rate, rate_covariance, np.zeros((3, 3)),
                 f'{len(frame.star_index)} stars {where}', hinted)


class HintedStart:
    """
    Starts by the newest hint, None without one, where an identified frame confirms it.

    The stars alone give the attitude. A false hint changes nothing but the rate, and where the
    stars are lost by that, hints are ignored until a start without one.
    """

    def __init__(self) -> None:
        self.newest: Hint | None = None
        self._ignored = self._used = False

    def add(self, hint: Hint) -> None:
        """Use a hint from now on."""
        self.newest = hint

    def start(self, frame: IdentifiedFrame, max_gap_s: float) -> Start | None:
        """Return the start at a frame that agrees with the hint; None without one."""
        hint = self.newest
        if (hint is None or self._ignored
                or abs(frame.stamp_ns - hint.stamp_ns) * 1e-9 > max_gap_s):
            return None
        return _confirmed(hint, frame, 'identified where a hint has them', hinted=True)

    def started(self, start: Start) -> None:
        """Note what the tracker has started with."""
        self._used = start.hinted
        self._ignored = self._ignored and self._used

    def lost(self, good_frames: int) -> None:
        """Note that the tracker has lost the stars after so many good frames."""
        self._ignored = self._ignored or (self._used and good_frames < HINT_FAILED.frames)
        self._used = False


def _is_within(covariance: np.ndarray, sigma: float) -> bool:
    """Return whether no axis of a covariance (3, 3) has a larger standard deviation."""
    # The trace is at least the largest eigenvalue, and known in a tenth of the time.
    return bool(np.trace(covariance) <= sigma ** 2
                or np.linalg.eigvalsh(covariance)[-1] <= sigma ** 2)
