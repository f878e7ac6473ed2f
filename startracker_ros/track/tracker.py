"""From identified frames to tracks: the LOST, ACQUIRING, TRACKING machine."""

from collections import deque
from dataclasses import replace
from enum import StrEnum
import math

import numpy as np
from startracker_ros.attitude.estimate import AttitudeError, AttitudeEstimate
from startracker_ros.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.synthetic_field import synthetic_field
from startracker_ros.maths.rotation import attitude_error, conjugate, rotate
from startracker_ros.track.attitude_model import AttitudeModel
from startracker_ros.track.in_view import StarsInView
from startracker_ros.track.model import Fix, rate_between, StarModel
from startracker_ros.track.newcomers import match_newcomers
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.rotation_fit import fit_rotation, median, OUTLIER_SIGMA, RotationFit
from startracker_ros.track.starwise import NeighbourhoodModel, StarwiseModel
from startracker_ros.track.tracks import TrackedAttitude, Tracks

RECENT_FRAMES = 64
"""Frames kept for an identification that comes late, and own attitudes to check it by:
6 s at 10 Hz, several times what a lost-in-space identification may take."""

TIME_JUMP_S = 1.0
"""A step back of time by more is a new beginning (a simulation, a recording played again);
by less, a frame that came late."""

DISAGREEMENT_SIGMA = 10.0
"""How far an identification may be from the tracks: far beyond what unmodelled errors of
the lens can do, far below the degrees of a wrong identification."""


class TrackerState(StrEnum):
    """What the tracker can be relied on for."""

    LOST = 'LOST'
    ACQUIRING = 'ACQUIRING'
    TRACKING = 'TRACKING'


class StarTracker:
    """
    Follows identified stars through frames of centroids.

    state and reason say how things stand; frames_since_fix counts frames since the stars
    last agreed on an attitude, stars_matched the stars that did, residual_px is their rms
    distance from the catalogue (NaN without any); late_frames counts frames refused
    because a newer one had come, refused_centroids those without a usable place or sigma,
    checks_passed the identifications that agreed with the tracks.
    Feed update() with every frame and identified() with the identifications, in any
    interleaving: an identification may come some frames late or before its own update().
    find_newcomers() may follow update(), when what it returned is on its way.
    add_rate() takes the rates of a gyro, where there is one.
    """

    def __init__(self, camera: Camera, places: StarPlaces,
                 options: TrackerOptions = TrackerOptions(),
                 gyro: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._camera = camera
        self._places = places
        self._options = options
        self._gyro_options = gyro
        self._stars = StarsInView(camera, places)
        self._unclaimed: tuple[RotationFit, Centroids] | None = None
        self._next_id = 1
        self.late_frames = 0
        self.refused_centroids = 0
        self.checks_passed = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything but the counts and the track numbers."""
        self._stamp_ns: int | None = None
        self._recent: deque[tuple[int, Centroids]] = deque(maxlen=RECENT_FRAMES)
        self._gyro = Gyro(self._gyro_options)
        self.frames_since_fix = 0
        self._enter(TrackerState.LOST, 'waiting for an identified frame')

    @property
    def attitude(self) -> TrackedAttitude | None:
        """Return the attitude of the newest frame, None unless its stars agree on one."""
        if not self._history or self._history[-1][0] != self._stamp_ns:
            return None
        return TrackedAttitude(self._history[-1][1], self._model.rate_rad_s,
                               self._model.rate_covariance)

    @property
    def gyro_trouble(self) -> str:
        """Why the rates of a gyro are not used, empty when there is nothing to say."""
        return self._model.gyro_trouble

    @property
    def gyro_condition(self) -> str:
        """Whether a gyro carries the attitude on: none, used or unused."""
        return 'none' if not len(self._gyro) else 'used' if self._model.uses_gyro else 'unused'

    def warm_up(self) -> None:
        """Compile and load what a frame needs, with a second tracker of a synthetic field."""
        tracker = StarTracker(self._camera, self._places, self._options)
        centroids, hip = synthetic_field(self._places, self._camera)
        for stamp_ns in (1, 2, 3):
            tracker.update(stamp_ns, centroids)
            tracker.identified(stamp_ns, centroids, hip)

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Take a rate (3,) about sensor axes measured up to a time; False if it is unusable."""
        return self._gyro.add(stamp_ns, rate_rad_s)

    def update(self, stamp_ns: int, centroids: Centroids) -> Tracks | None:
        """
        Take the centroids of a frame and return the tracks, empty unless TRACKING.

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
        return self._model.bank.published(
            self._places, self._good_stamp_ns == self._bank_stamp_ns)

    def find_newcomers(self) -> None:
        """
        Begin tracks of stars that came into view in the last frame, to be among the next tracks.

        The next update() does it first, if nobody has: called before, it need not wait for it.
        """
        if self._unclaimed is None:
            return
        (fit, frame), self._unclaimed = self._unclaimed, None
        bank = self._model.bank
        room = self._options.max_stars - len(bank)
        if room <= 0 or not len(frame):
            return
        seen = bank.seen
        with np.errstate(invalid='ignore', divide='ignore'):
            zero_point = median(
                self._places.magnitude[bank.place[seen]] + 2.5 * np.log10(bank.flux[seen]))
        place, centroid = match_newcomers(
            self._stars, fit.attitude, frame, fit.scale * self._model.sigma_px(frame), zero_point,
            self._options.magnitude_tolerance)
        if len(place):
            new = ~(place[:, None] == bank.place).any(axis=1)
            place, centroid = place[new][:room], centroid[new][:room]
        if len(place):
            self._add_tracks(place, frame.select(centroid), confirmed=False)

    def identified(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> None:
        """
        Take an identified frame: hip (N,) of each centroid, 0 where it is not known.

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
        self._first: Fix | None = None
        self._model = make_model(self._camera, self._places, self._options, self._gyro)
        self._unclaimed = None
        self._bank_stamp_ns = 0
        self._good_stamp_ns = 0
        self._bad_frames = 0
        self._history: deque[tuple[int, AttitudeEstimate]] = deque(maxlen=RECENT_FRAMES)

    def _too_far(self, stamp_ns: int, other_ns: int) -> bool:
        return abs(stamp_ns - other_ns) * 1e-9 > self._options.max_gap_s

    def _usable(self, centroids: Centroids) -> tuple[Centroids, np.ndarray]:
        """Return the centroids that can be measured with, and the mask (N,) that chose them."""
        good = (np.isfinite(centroids.uv).all(axis=1) & np.isfinite(centroids.sigma_px)
                & (centroids.sigma_px > 0))
        refused = len(good) - int(np.count_nonzero(good))
        if not refused:
            return centroids, good
        self.refused_centroids += refused
        return centroids.select(good), good

    # --- from identifications to tracks ---

    def _solve(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> Fix | None:
        """Return the fix of an identified frame, None unless it is a good one."""
        options = self._options
        centroids, good = self._usable(centroids)
        place = self._places.index_of(np.asarray(hip)[good])
        known = (place >= 0) & ~self._places.crowded[place]
        # A star named twice is taken once, at its brightest centroid.
        known[known] = _first_of_each(place[known])
        centroids, place = centroids.select(known), place[known]
        if len(place) < options.min_stars:
            return None
        try:
            fit = fit_rotation(self._camera, self._places.direction[place], centroids.uv,
                               self._model.sigma_px(centroids),
                               np.ones(len(place), bool))
        except AttitudeError:
            return None
        if not fit.is_good(len(place), options.min_stars, options.max_residual_px):
            return None
        return Fix(stamp_ns, place[fit.inlier], centroids.select(fit.inlier), fit.attitude,
                   fit.scale)

    def _acquire(self, fix: Fix, reason: str) -> None:
        self._enter(TrackerState.ACQUIRING, reason)
        self._first = fix

    def _start(self, first: Fix, fix: Fix) -> None:
        """Start tracks at the second of two fixes, then catch up with the frames since."""
        rate_deg_s = np.degrees(np.linalg.norm(
            rate_between(first.stamp_ns, first.attitude, fix.stamp_ns, fix.attitude)))
        if rate_deg_s > self._options.max_rate_deg_s:
            self._acquire(fix, f'two identifications {rate_deg_s:.3g} deg/s apart')
            return
        self._enter(TrackerState.TRACKING, f'{len(fix.place)} stars identified twice')
        self._model.start(fix, first)
        most = slice(self._options.max_stars)
        self._add_tracks(fix.place[most], fix.centroids.select(most), confirmed=True)
        self._bank_stamp_ns = self._good_stamp_ns = fix.stamp_ns
        self.stars_matched = len(fix.place)
        self.frames_since_fix = 0
        self._history.append((fix.stamp_ns, fix.attitude))
        for stamp_ns, frame in list(self._recent):
            if stamp_ns > fix.stamp_ns and self.state is TrackerState.TRACKING:
                self._follow(stamp_ns, frame)

    def _cross_check(self, fix: Fix) -> None:
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
        else:
            self.checks_passed += 1

    # --- from frame to frame ---

    def _follow(self, stamp_ns: int, frame: Centroids) -> None:
        """Bring the tracks to a newer frame."""
        if self._too_far(stamp_ns, self._good_stamp_ns):
            gap_s = (stamp_ns - self._good_stamp_ns) * 1e-9
            self._enter(TrackerState.LOST, f'no stars for {gap_s:.1f} s')
        if stamp_ns <= self._bank_stamp_ns or self.state is not TrackerState.TRACKING:
            return
        self.find_newcomers()
        self._bank_stamp_ns = stamp_ns
        model, options = self._model, self._options
        followed = model.follow(stamp_ns, frame)
        bank, fit = model.bank, followed.fit
        if fit is None:
            self.stars_matched, self.residual_px = 0, math.nan
        else:
            self.stars_matched, self.residual_px = int(fit.inlier.sum()), fit.residual_px
        if fit is None or not followed.good:
            # A dark image says nothing of the stars; one with others contradicts them.
            self._bad_frames += not model.is_dark(frame)
            self._drop(bank.missed > self._allowed_to_miss(frame))
            if self._bad_frames >= options.max_bad_frames:
                self._enter(
                    TrackerState.LOST,
                    f'{self._bad_frames} bad frames: {self.stars_matched} stars agreed in the '
                    f'last one, residual {self.residual_px:.2f} px')
            return
        self._bad_frames = 0
        self._good_stamp_ns = stamp_ns
        self.frames_since_fix = 0
        self._history.append((stamp_ns, fit.attitude))
        self._drop((bank.missed > self._allowed_to_miss(frame))
                   | (fit.normalised > OUTLIER_SIGMA) & (bank.missed == 0))
        model.bank = replace(model.bank, confirmed=model.bank.confirmed | (
            model.bank.age >= options.confirm_frames))
        self._unclaimed = fit, frame.select(followed.unclaimed)

    def _allowed_to_miss(self, frame: Centroids) -> np.ndarray:
        """Return how often (N,) a star may be missed: not yet confirmed ones never."""
        most = np.inf if self._model.is_dark(frame) else self._options.max_missed
        return np.where(self._model.bank.confirmed, most, 0)

    def _drop(self, unwanted: np.ndarray) -> None:
        self._model.bank = self._model.bank.select(~unwanted)

    def _add_tracks(self, place: np.ndarray, centroids: Centroids, *, confirmed: bool) -> None:
        track_id = np.arange(self._next_id, self._next_id + len(place))
        self._next_id += len(place)
        self._model.add(track_id, place, centroids, confirmed=confirmed)


def _first_of_each(values: np.ndarray) -> np.ndarray:
    """Return True (N,) at the first occurrence of each value."""
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first


def make_model(camera: Camera, places: StarPlaces, options: TrackerOptions, gyro: Gyro
               ) -> StarModel:
    """Return the model that the options name."""
    if options.model == 'attitude':
        return AttitudeModel(camera, places, options, gyro)
    starwise = NeighbourhoodModel if options.model == 'sna' else StarwiseModel
    return starwise(camera, places, options)
