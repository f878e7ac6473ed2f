"""From identified frames to tracks: the LOST, ACQUIRING, TRACKING machine."""

from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
import math

import numpy as np

from startracker_ros.attitude.estimate import AttitudeError, AttitudeEstimate
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.options import option, Options
from startracker_ros.rotation import attitude_error, conjugate, rotate
from startracker_ros.track.association import (
    event_weights, gate_size, gated_density, joint_probabilities)
from startracker_ros.track.bank import TrackBank
from startracker_ros.track.jpdaf import predict, update
from startracker_ros.track.motion_models import (
    body_rate, constant_velocity, image_jacobian, turn_curvature)
from startracker_ros.track.newcomers import match_newcomers
from startracker_ros.track.rotation_fit import fit_rotation, OUTLIER_SIGMA, RotationFit
from startracker_ros.track.tracks import Tracks

RECENT_FRAMES = 64
"""Frames kept for an identification that comes late, and own attitudes to check it by:
6 s at 10 Hz, several times what a lost-in-space identification may take."""

TIME_JUMP_S = 1.0
"""A step back of time by more is a new beginning (a simulation, a recording played again);
by less, a frame that came late."""

DISAGREEMENT_SIGMA = 10.0
"""How far an identification may be from the tracks: far beyond what unmodelled errors of
the lens can do, far below the degrees of a wrong identification."""


@dataclass(frozen=True)
class TrackerOptions(Options):
    """When stars are followed, and when they are given up."""

    magnitude_limit: float = option(
        9.0, 'faintest catalogue stars that are followed', unit='mag', low=0.0, high=9.0)
    max_stars: int = option(
        40, 'most stars followed at a time, brightest first', low=4, high=500)
    min_stars: int = option(
        4, 'fewest stars that must be seen and move as one for a frame to count as good',
        low=3, high=100)
    acceleration_deg_s2: float = option(
        0.005, 'unforeseen change of the body rate, 1 sigma; more follows manoeuvres faster, '
        'less filters better', unit='deg/s^2', low=1e-6, high=100.0)
    sigma_floor_px: float = option(
        0.01, 'smallest error of a centroid that is believed, 1 sigma per axis', unit='px',
        low=1e-4, high=10.0)
    detection_probability: float = option(
        0.95, 'how often a followed star is among the centroids', low=0.01, high=0.999)
    gate_probability: float = option(
        0.9999, 'how often the centroid of a star is inside its gate', low=0.5, high=0.999999)
    max_missed: int = option(
        5, 'frames in a row without a centroid after which a star is dropped', unit='frames',
        low=0, high=200)
    confirm_frames: int = option(
        3, 'frames in a row in which a newly found star must be seen before it counts',
        unit='frames', low=1, high=100)
    magnitude_tolerance: float = option(
        1.0, 'largest difference of brightness between a newly found star and the catalogue',
        unit='mag', low=0.05, high=20.0)
    max_residual_px: float = option(
        1.0, 'largest root mean square distance of the stars from their catalogue places in a '
        'good frame; raise it for a lens that is not calibrated', unit='px', low=0.01, high=100.0)
    max_bad_frames: int = option(
        5, 'bad frames in a row after which the tracker is lost', unit='frames', low=1, high=1000)
    max_rate_deg_s: float = option(
        3.0, 'fastest turn believed between two identifications', unit='deg/s', low=0.001,
        high=100.0)
    max_gap_s: float = option(
        2.0, 'longest time without a frame, and between the two identifications of a start',
        unit='s', low=0.01, high=600.0)


class TrackerState(str, Enum):
    """What the tracker can be relied on for."""

    LOST = 'LOST'
    ACQUIRING = 'ACQUIRING'
    TRACKING = 'TRACKING'


@dataclass(frozen=True)
class _Fix:
    """An identified frame that fits the catalogue: its known stars and their attitude."""

    stamp_ns: int
    place: np.ndarray
    centroids: Centroids
    attitude: AttitudeEstimate


class StarTracker:
    """Follows identified stars through frames of centroids.

    state and reason say how things stand; frames_since_fix counts frames since the stars
    last agreed on an attitude, stars_matched the stars that did, residual_px is their rms
    distance from the catalogue (NaN without any); late_frames counts frames refused
    because a newer one had come, refused_centroids those without a usable place or sigma.
    Feed update() with every frame and identified() with the identifications, in any
    interleaving: an identification may come some frames late or before its own update().
    """

    def __init__(self, camera: Camera, places: StarPlaces,
                 options: TrackerOptions = TrackerOptions()) -> None:
        self._camera = camera
        self._places = places
        self._options = options
        self._gate = gate_size(options.gate_probability)
        acceleration_rad_s2 = np.radians(options.acceleration_deg_s2)
        self._acceleration_px_s2 = (
            acceleration_rad_s2 * camera.fx, acceleration_rad_s2 * camera.fy)
        self._next_id = 1
        self.late_frames = 0
        self.refused_centroids = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything but the counts and the track numbers."""
        self._stamp_ns: int | None = None
        self._recent: deque[tuple[int, Centroids]] = deque(maxlen=RECENT_FRAMES)
        self.frames_since_fix = 0
        self._enter(TrackerState.LOST, 'waiting for an identified frame')

    def update(self, stamp_ns: int, centroids: Centroids) -> Tracks | None:
        """Take the centroids of a frame and return the tracks, empty unless TRACKING.

        Return None, and count a late frame, when its stamp is not newer than the last one.
        """
        if self._stamp_ns is not None and stamp_ns <= self._stamp_ns:
            back_s = (self._stamp_ns - stamp_ns) * 1e-9
            if back_s <= TIME_JUMP_S:
                self.late_frames += 1
                return None
            self.reset()
            self.reason = f'time jumped back by {back_s:.1f} s'
        frame = self._usable(centroids)[0]
        self._stamp_ns = stamp_ns
        self._recent.append((stamp_ns, frame))
        self.frames_since_fix += 1
        if self._first is not None and self._too_far(self._first.stamp_ns, stamp_ns):
            self._enter(TrackerState.LOST,
                        f'no second identification within {self._options.max_gap_s:g} s')
        if self.state is TrackerState.TRACKING and stamp_ns != self._bank_stamp_ns:
            self._follow(stamp_ns, frame)
        if self.state is not TrackerState.TRACKING or stamp_ns != self._bank_stamp_ns:
            return Tracks.empty()
        return self._bank.published(self._places, self._bad_frames == 0)

    def identified(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> None:
        """Take an identified frame: hip (N,) of each centroid, 0 where it is not known.

        Two that agree start the tracks. While TRACKING one that contradicts the tracks
        throws everything out. Frames with too few stars or a poor fit are passed over.
        """
        fix = self._solve(stamp_ns, centroids, hip)
        if fix is None:
            return
        if self.state is TrackerState.TRACKING:
            self._cross_check(fix)
        elif self._first is None or self._too_far(self._first.stamp_ns, stamp_ns):
            self._acquire(fix, f'first identification, {len(fix.place)} stars')
        elif stamp_ns > self._first.stamp_ns:
            self._start(self._first, fix)

    def _enter(self, state: TrackerState, reason: str) -> None:
        """Change the state; whatever was tracked or kept is forgotten."""
        self.state = state
        self.reason = reason
        self.stars_matched = 0
        self.residual_px = math.nan
        self._first: _Fix | None = None
        self._bank = TrackBank.empty()
        self._bank_stamp_ns = 0
        self._bad_frames = 0
        self._rate = np.zeros(3)
        self._rate_covariance = np.zeros((3, 3))
        self._history: deque[tuple[int, AttitudeEstimate]] = deque(maxlen=RECENT_FRAMES)

    def _too_far(self, stamp_ns: int, other_ns: int) -> bool:
        return abs(stamp_ns - other_ns) * 1e-9 > self._options.max_gap_s

    def _usable(self, centroids: Centroids) -> tuple[Centroids, np.ndarray]:
        """Return the centroids that can be measured with, and the mask (N,) that chose them."""
        good = (np.isfinite(centroids.uv).all(axis=1) & np.isfinite(centroids.sigma_px)
                & (centroids.sigma_px > 0))
        self.refused_centroids += int(np.count_nonzero(~good))
        return centroids.select(good), good

    def _sigma(self, centroids: Centroids) -> np.ndarray:
        return np.maximum(centroids.sigma_px, self._options.sigma_floor_px)

    # --- from identifications to tracks ---

    def _solve(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> _Fix | None:
        """Return the fix of an identified frame, None unless it is a good one."""
        centroids, good = self._usable(centroids)
        place = self._places.index_of(np.asarray(hip)[good])
        known = (place >= 0) & ~self._places.crowded[place]
        # A star named twice is taken once, at its brightest centroid.
        known[known] = _first_of_each(place[known])
        centroids, place = centroids.select(known), place[known]
        if len(place) < self._options.min_stars:
            return None
        try:
            fit = fit_rotation(self._camera, self._places.direction[place], centroids.uv,
                               self._sigma(centroids), np.ones(len(place), bool))
        except AttitudeError:
            return None
        if not self._is_good(fit, len(place)):
            return None
        return _Fix(stamp_ns, place[fit.inlier], centroids.select(fit.inlier), fit.attitude)

    def _is_good(self, fit: RotationFit, stars: int) -> bool:
        return (fit.inlier.sum() >= max(self._options.min_stars, math.ceil(stars / 3))
                and fit.residual_px <= self._options.max_residual_px)

    def _acquire(self, fix: _Fix, reason: str) -> None:
        self._enter(TrackerState.ACQUIRING, reason)
        self._first = fix

    def _start(self, first: _Fix, fix: _Fix) -> None:
        """Start tracks at the second of two fixes, then catch up with the frames since."""
        dt_s = (fix.stamp_ns - first.stamp_ns) * 1e-9
        rate = attitude_error(fix.attitude.quaternion, first.attitude.quaternion) / dt_s
        rate_deg_s = np.degrees(np.linalg.norm(rate))
        if rate_deg_s > self._options.max_rate_deg_s:
            self._acquire(fix, f'two identifications {rate_deg_s:.3g} deg/s apart')
            return
        self._enter(TrackerState.TRACKING, f'{len(fix.place)} stars identified twice')
        self._rate = rate
        self._rate_covariance = (
            first.attitude.covariance_sensor + fix.attitude.covariance_sensor) / dt_s ** 2
        most = slice(self._options.max_stars)
        self._bank = self._new_tracks(fix.place[most], fix.centroids.select(most),
                                      confirmed=True)
        self._bank_stamp_ns = fix.stamp_ns
        self.stars_matched = len(fix.place)
        self.frames_since_fix = 0
        self._history.append((fix.stamp_ns, fix.attitude))
        for stamp_ns, frame in list(self._recent):
            if stamp_ns > fix.stamp_ns and self.state is TrackerState.TRACKING:
                self._follow(stamp_ns, frame)

    def _cross_check(self, fix: _Fix) -> None:
        """Compare a fix with the own attitude of the same frame, where there is one."""
        own = next((attitude for stamp_ns, attitude in self._history
                    if stamp_ns == fix.stamp_ns), None)
        if own is None:
            return
        error = attitude_error(fix.attitude.quaternion, own.quaternion)
        covariance = fix.attitude.covariance_sensor + own.covariance_sensor
        sigmas = math.sqrt(error @ np.linalg.solve(covariance, error))
        sensor = rotate(conjugate(own.quaternion), self._places.direction[fix.place])
        shift = self._camera.project(sensor) - fix.centroids.uv
        # Both must speak: a rough sigma alone, or a poor lens alone, is no contradiction.
        distance_px = np.sqrt(np.mean(np.sum(shift ** 2, axis=1)))
        if sigmas > DISAGREEMENT_SIGMA and not distance_px <= 3 * self._options.max_residual_px:
            self._acquire(fix, f'an identification contradicts the tracks by '
                               f'{np.degrees(np.linalg.norm(error)):.3g} deg')

    # --- from frame to frame ---

    def _follow(self, stamp_ns: int, frame: Centroids) -> None:
        """Bring the tracks to a newer frame."""
        if self._too_far(stamp_ns, self._bank_stamp_ns):
            gap_s = abs(stamp_ns - self._bank_stamp_ns) * 1e-9
            self._enter(TrackerState.LOST, f'no frame for {gap_s:.1f} s')
        if stamp_ns <= self._bank_stamp_ns or self.state is not TrackerState.TRACKING:
            return
        self._predict((stamp_ns - self._bank_stamp_ns) * 1e-9)
        self._bank_stamp_ns = stamp_ns
        unclaimed = self._associate(frame)
        self._drop_missed()
        fit = self._fit()
        if fit is None:
            self.stars_matched, self.residual_px = 0, math.nan
        else:
            self.stars_matched, self.residual_px = int(fit.inlier.sum()), fit.residual_px
        if fit is None or not self._is_good(fit, np.count_nonzero(self._bank.confirmed)):
            self._bad_frames += 1
            if self._bad_frames >= self._options.max_bad_frames:
                self._enter(
                    TrackerState.LOST,
                    f'{self._bad_frames} bad frames: {self.stars_matched} stars agreed in the '
                    f'last one, residual {self.residual_px:.2f} px')
            return
        self._bad_frames = 0
        self.frames_since_fix = 0
        self._history.append((stamp_ns, fit.attitude))
        keep = (fit.normalised <= OUTLIER_SIGMA) | (self._bank.missed > 0)
        self._bank = self._bank.select(keep)
        self._bank = replace(self._bank, confirmed=self._bank.confirmed | (
            self._bank.age >= self._options.confirm_frames))
        self._estimate_rate()
        self._find_newcomers(fit, frame.select(unclaimed))

    def _predict(self, dt_s: float) -> None:
        transition, noise = constant_velocity(dt_s, self._acceleration_px_s2)
        noise = self._shares()[:, None, None] * noise
        state, covariance = predict(self._bank.state, self._bank.covariance, transition, noise)
        state += turn_curvature(self._camera, self._bank.uv, self._rate, dt_s)
        bank = replace(self._bank, state=state, covariance=covariance)
        self._bank = bank.select(self._camera.contains(bank.uv))

    def _shares(self) -> np.ndarray:
        """Return how many times (N,) the camera's process noise each track is given.

        An acceleration of the camera moves all stars alike, so it does not average out over
        them as centroid errors do: once per track would make the attitude of all tracks
        too sure of itself. Times the variance of a star over that of the mean of all stars,
        which is N times if they are equally good, each track has the gain of one filter
        of the common motion, and the attitude of all tracks the covariance of that filter.
        """
        bank = self._bank
        information = np.sum(1 / bank.variance[bank.confirmed])
        return np.maximum(1.0, bank.variance * information)

    def _associate(self, frame: Centroids) -> np.ndarray:
        """Update the tracks with a frame and return its centroids (M,) that no track wants."""
        variance = self._sigma(frame) ** 2
        density = gated_density(self._bank.uv, self._bank.uv_covariance, frame.uv, variance,
                                self._gate)
        unclaimed = ~(density > 0).any(axis=0)
        # One more than counted: a frame without false centroids does not prove there are none.
        clutter_px2 = (1 + unclaimed.sum()) / (self._camera.width * self._camera.height)
        probability = joint_probabilities(event_weights(
            density, self._options.detection_probability, self._options.gate_probability,
            clutter_px2))
        state, covariance = update(self._bank.state, self._bank.covariance, frame.uv, variance,
                                   probability)
        self._bank = self._bank.observed(state, covariance, probability, frame, variance)
        return unclaimed

    def _drop_missed(self) -> None:
        """A star not yet confirmed must be seen in every frame, the others now and then."""
        allowed = np.where(self._bank.confirmed, self._options.max_missed, 0)
        self._bank = self._bank.select(self._bank.missed <= allowed)

    def _fit(self) -> RotationFit | None:
        try:
            return fit_rotation(self._camera, self._places.direction[self._bank.place],
                                self._bank.uv, self._bank.sigma_uv, self._bank.seen)
        except AttitudeError:
            return None

    def _estimate_rate(self) -> None:
        bank = self._bank.select(self._bank.seen)
        self._rate, self._rate_covariance = body_rate(
            image_jacobian(self._camera, self._camera.unproject(bank.uv)),
            bank.state[:, 1::2], bank.covariance[:, 1::2, 1::2])

    def _find_newcomers(self, fit: RotationFit, frame: Centroids) -> None:
        room = self._options.max_stars - len(self._bank)
        if room <= 0 or not len(frame):
            return
        seen = self._bank.select(self._bank.seen)
        with np.errstate(invalid='ignore', divide='ignore'):
            zero_point = np.median(
                self._places.magnitude[seen.place] + 2.5 * np.log10(seen.flux))
        place, centroid = match_newcomers(
            self._camera, self._places, fit.attitude, frame, fit.scale * self._sigma(frame),
            zero_point, self._options.magnitude_tolerance)
        new = ~np.isin(place, self._bank.place)
        place, centroid = place[new][:room], centroid[new][:room]
        if len(place):
            self._bank = self._bank.joined(self._new_tracks(
                place, frame.select(centroid), confirmed=False))

    def _new_tracks(self, place: np.ndarray, centroids: Centroids, *, confirmed: bool
                    ) -> TrackBank:
        """Return tracks (N,) that begin at centroids and move as the body rate says."""
        jacobian = image_jacobian(self._camera, self._camera.unproject(centroids.uv))
        track_id = np.arange(self._next_id, self._next_id + len(place))
        self._next_id += len(place)
        return TrackBank.started(
            track_id, place, centroids, self._sigma(centroids) ** 2, jacobian @ self._rate,
            jacobian @ self._rate_covariance @ np.swapaxes(jacobian, 1, 2), confirmed)


def _first_of_each(values: np.ndarray) -> np.ndarray:
    """Return True (N,) at the first occurrence of each value."""
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first
