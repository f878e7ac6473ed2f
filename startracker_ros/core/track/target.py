# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The target: the one centroid that is not a star and moves against the stars."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog, ApparentSky
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.core.options import option, Options
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.motion_models import constant_velocity, POSITION, VELOCITY

EXPLAINED_PX = 2.0
"""A centroid within this of a catalogue star, or within EXPLAINED_SIGMA, is that star."""

EXPLAINED_SIGMA = 5.0
GATE = 16.0
"""Normalised innovation squared within which a centroid is associated."""

MOVES_SIGMA = 5.0
"""Least displacement against the stars, in sigma."""

MAX_GAP_S = 5.0
"""Time without an attitude after which all tracks are dropped."""

MOST_SPOTS = 50
"""Brightest unexplained centroids that are used, and tracks that are predicted; a frame with more
is full of noise."""


@dataclass(frozen=True)
class TargetTrackOptions(Options):
    """When a centroid that is not a star counts as a target."""

    target_min_rate_deg_s: float = option(
        0.001, 'slowest motion of a target against the stars', unit='deg/s', low=1e-6, high=10.0)
    target_max_rate_deg_s: float = option(
        1.0, 'fastest motion of a target against the stars', unit='deg/s', low=1e-4, high=10.0)
    target_acceleration_deg_s2: float = option(
        0.01, 'process noise, 1 sigma of the angular acceleration of that motion',
        unit='deg/s^2', low=1e-6, high=10.0)
    target_confirm_frames: int = option(
        5, 'frames in a row in which a target must be seen before it counts', unit='frames',
        low=3, high=100)
    target_max_gap_s: float = option(
        2.0, 'how long a target may be hidden, by a star that it passes, before it is given up',
        unit='s', low=0.0, high=5.0)
    target_min_shift_px: float = option(
        1.0, 'how far it must have moved in the image: a detection that stays on its pixels while '
        'the stars move is a defect of the sensor', unit='px', low=0.0, high=100.0)


@dataclass
class _Track:
    """
    A track: direction (3,) on ICRF axes, its rate (3,) in rad/s, across it.

    basis (2, 3) spans the plane across the direction, covariance (4, 4) is that of position
    and rate along either, in the order of constant_velocity(). The first detection, age_s ago, was
    at first_direction (3,) with first_variance and at first_uv (2,); shift_px is the largest
    distance from it in the image.
    """

    direction: np.ndarray
    rate: np.ndarray
    basis: np.ndarray
    covariance: np.ndarray
    first_direction: np.ndarray
    first_variance: float
    first_uv: np.ndarray
    age_s: float
    shift_px: float
    detections: int = 2
    missed_s: float = 0.0

    def predict(self, dt_s: float, acceleration_rad_s2: float) -> None:
        self.age_s += dt_s
        self.direction = _unit(self.direction + self.rate * dt_s)
        first = _unit(self.basis[0] - self.direction * (self.direction @ self.basis[0]))
        self.basis = np.stack([first, np.cross(self.direction, first)])
        self.rate = self.rate - self.direction * (self.direction @ self.rate)
        self.covariance = self.covariance_in(dt_s, acceleration_rad_s2)

    def covariance_in(self, dt_s: float, acceleration_rad_s2: float) -> np.ndarray:
        """Return the covariance (4, 4) after a time."""
        transition, noise = constant_velocity(dt_s, (acceleration_rad_s2, acceleration_rad_s2))
        return transition @ self.covariance @ transition.T + noise

    def nis(self, directions: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Return the normalised innovations squared (M,) of directions (M, 3), variance (M,)."""
        z = directions @ self.basis.T
        S = self.covariance[np.ix_(POSITION, POSITION)] + variance[:, None, None] * np.eye(2)
        ahead = directions @ self.direction > 0
        solved = np.linalg.solve(S, z[..., None])[..., 0]
        return np.where(ahead, np.sum(z * solved, axis=1), np.inf)

    def update(self, direction: np.ndarray, variance: float, uv: np.ndarray) -> None:
        """K = P H^T S^-1, x <- x + K z, P <- P - K H P."""
        S = self.covariance[np.ix_(POSITION, POSITION)] + variance * np.eye(2)
        K = np.linalg.solve(S, self.covariance[POSITION]).T
        change = K @ (self.basis @ direction)
        self.covariance = self.covariance - K @ self.covariance[POSITION]
        self.direction = _unit(self.direction + change[POSITION] @ self.basis)
        self.rate = self.rate + change[VELOCITY] @ self.basis
        self.detections += 1
        self.missed_s = 0.0
        self.shift_px = max(self.shift_px, float(np.linalg.norm(uv - self.first_uv)))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def unexplained(stars: StarsInView, sky: ApparentCatalog, attitude: AttitudeEstimate,
                centroids: Centroids) -> np.ndarray:
    """Return which centroids (K,) are not a catalogue star; none without a positive sigma."""
    return stars.unexplained(
        sky, attitude, centroids.uv, centroids.sigma_px, EXPLAINED_PX, EXPLAINED_SIGMA)


@dataclass(frozen=True)
class TargetSpot:
    """
    The target in a frame: its measured centroid, a list of one, and its motion.

    rate_deg_s against the stars, frames since its first detection.
    """

    centroid: Centroids
    rate_deg_s: float
    frames: int


class TargetTracker:
    """
    Tracks the centroids that are not stars; feed update() with every frame.

    A track begins with a pair of centroids in two frames in a row, of images that are searched as
    a whole. From then on predicted() has it, so that it is measured in the others as well. spots
    counts the centroids that are not stars in the last frame.
    """

    def __init__(self, camera: Camera, sky: ApparentSky,
                 options: TargetTrackOptions = TargetTrackOptions()) -> None:
        """Use the sky of the star tracker whose attitudes are used."""
        self._camera = camera
        self._sky, self._stars = sky, StarsInView(camera, sky.onboard)
        self._options = options
        self._acceleration_rad_s2 = np.radians(options.target_acceleration_deg_s2)
        self._rates_rad_s = np.radians([options.target_min_rate_deg_s,
                                        options.target_max_rate_deg_s])
        self.reset()

    def reset(self) -> None:
        """Drop everything."""
        self._stamp_ns = 0
        self._tracks: list[_Track] = []
        self._target: _Track | None = None
        self._before = Centroids.empty(), np.empty((0, 3)), np.empty(0)
        self._interval_s = 0.0
        self._searched_before = self._needs_search = False
        self.spots = 0

    def update(self, stamp_ns: int, attitude: AttitudeEstimate, centroids: Centroids,
               windowed: bool = False) -> TargetSpot | None:
        """
        Process a frame with its attitude; return the target if it is detected.

        Where windowed, only what was predicted was measured. Stamps ascend; one that is not newer
        resets it. Frames without an attitude are left out.
        """
        dt_s = (stamp_ns - self._stamp_ns) * 1e-9
        if not 0 < dt_s <= MAX_GAP_S:
            self.reset()
        self._stamp_ns, self._interval_s, self._attitude = stamp_ns, dt_s, attitude
        spots = unexplained(self._stars, self._sky.at(stamp_ns), attitude, centroids)
        self.spots = len(spots)
        left = centroids.select(spots[:MOST_SPOTS])
        directions = rotate(attitude.quaternion, self._camera.unproject(left.uv))
        attitude_variance = np.trace(attitude.covariance_sensor[:2, :2]) / 2
        variance = (left.sigma_px * self._camera.pixel_rad) ** 2 + attitude_variance
        free = np.ones(len(left), bool)
        associated: dict[int, int] = {}
        # The longest track has the first choice.
        self._tracks.sort(key=lambda track: -track.detections)
        for number, track in enumerate(self._tracks):
            track.predict(dt_s, self._acceleration_rad_s2)
            track.missed_s += dt_s
            nis = np.where(free, track.nis(directions, variance), np.inf)
            if len(left) and nis.min() <= GATE:
                nearest = int(nis.argmin())
                free[nearest] = False
                associated[number] = nearest
                track.update(directions[nearest], variance[nearest], left.uv[nearest])
        target = self._choose(associated)
        kept: list[_Track] = []
        dropped: list[_Track] = []
        for track in self._tracks:
            longest_s = self._options.target_max_gap_s if self._confirmed(track) else 0
            (kept if track.missed_s <= longest_s else dropped).append(track)
        self._tracks = kept + self._started(left.uv[free], directions[free], variance[free], dt_s)
        if self._target is not None and all(track is not self._target for track in kept):
            self._target = None
        self._before = left.select(free), directions[free], variance[free]
        if not windowed:
            self._needs_search = bool(free.any()) and not self._searched_before
        # A pair of chance is seldom seen a third time, a faint target is and may then be missed.
        self._needs_search |= any(track.detections > 2 for track in dropped)
        self._searched_before = not windowed
        if target is None or self._target is None:
            return None
        return TargetSpot(left.select(np.array([associated[target]])),
                          float(np.degrees(np.linalg.norm(self._target.rate))),
                          self._target.detections)

    def predicted(self, rate_rad_s: np.ndarray) -> PredictedCentroids:
        """
        Return where the tracks are in the image of the last update(), at its body rate (3,).

        The errors are those one interval later. While a spot in an image that was searched as a
        whole lacks a second such image, a last centroid may be anywhere.
        """
        uv, velocity, sigma_px = np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
        if self._tracks:
            uv, velocity, sigma_px = self._tracks_in_image(rate_rad_s)
        if self._needs_search:
            size_px = np.array([self._camera.width, self._camera.height], float)
            uv = np.concatenate([uv, [(size_px - 1) / 2]])
            velocity = np.concatenate([velocity, np.zeros((1, 2))])
            sigma_px = np.append(sigma_px, size_px.max())
        return PredictedCentroids(
            self._stamp_ns, uv, velocity, sigma_px, np.zeros(len(uv), np.int32), 0)

    def _tracks_in_image(self, rate_rad_s: np.ndarray
                         ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pixels (K, 2), velocity (K, 2) and error (K,) of predicted()."""
        tracks, attitude = self._tracks[:MOST_SPOTS], self._attitude
        icrf = np.array([track.direction for track in tracks])
        rate = np.array([track.rate for track in tracks])
        to_sensor = conjugate(attitude.quaternion)
        sensor = rotate(to_sensor, icrf)
        # Under the body rate w a star moves by -w x d, a target by its own turn d x d' as well.
        turn = rate_rad_s - rotate(to_sensor, np.cross(icrf, rate))
        variance = np.trace(attitude.covariance_sensor[:2, :2]) / 2 + np.array([
            np.trace(track.covariance_in(self._interval_s, self._acceleration_rad_s2)[
                np.ix_(POSITION, POSITION)]) / 2 for track in tracks])
        uv = self._camera.project(sensor)
        velocity = np.einsum('nij,nj->ni', image_jacobian(self._camera, sensor), turn)
        inside = self._camera.contains(uv)
        return uv[inside], velocity[inside], (np.sqrt(variance) / self._camera.pixel_rad)[inside]

    def _confirmed(self, track: _Track) -> bool:
        # Not the filtered rate, whose sigma allows for a manoeuvre at any time.
        moved_rad = np.linalg.norm(track.direction - track.first_direction)
        sigma_rad = np.sqrt(track.first_variance + np.trace(
            track.covariance[np.ix_(POSITION, POSITION)]) / 2)
        return (track.detections >= self._options.target_confirm_frames
                and track.shift_px >= self._options.target_min_shift_px
                and moved_rad >= max(self._rates_rad_s[0] * track.age_s, MOVES_SIGMA * sigma_rad))

    def _choose(self, associated: dict[int, int]) -> int | None:
        """Return the number of the target's track, None if it is not detected."""
        if self._target is None:
            # The longest track comes first.
            self._target = next((track for track in self._tracks if self._confirmed(track)), None)
        return next((number for number in associated
                     if self._tracks[number] is self._target), None)

    def _started(self, uv: np.ndarray, directions: np.ndarray, variance: np.ndarray,
                 dt_s: float) -> list[_Track]:
        """Return a track for each pair of a centroid (N,) with one of the frame before."""
        before, old_directions, old_variance = self._before
        moved = directions[:, None] - old_directions
        rate = np.linalg.norm(moved, axis=-1) / dt_s
        slowest, fastest = self._rates_rad_s
        started = []
        for new, old in zip(*np.nonzero((rate >= slowest) & (rate <= fastest))):
            direction = directions[new]
            first = _unit(np.cross(direction, np.eye(3)[np.abs(direction).argmin()]))
            own, both = variance[new], variance[new] + old_variance[old]
            block = np.array([[own, own / dt_s], [own / dt_s, both / dt_s ** 2]])
            change = moved[new, old] / dt_s
            started.append(_Track(
                direction, change - direction * (direction @ change),
                np.stack([first, np.cross(direction, first)]), np.kron(np.eye(2), block),
                old_directions[old], old_variance[old], before.uv[old], dt_s,
                float(np.linalg.norm(uv[new] - before.uv[old]))))
        return started
