# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The filter of the tracks: from identified frames of stars to tracks of stars."""

from collections import deque
from dataclasses import replace
from enum import StrEnum
import math

import numpy as np
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog, ApparentSky
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.centroid.synthetic_field import synthetic_field
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import (
    BAD_FRAMES, FAST_TURN, IDENTIFICATION_DIFFERS, LATE_FRAME, NO_STARS, REPEATED_FRAME,
    SECOND_IMAGE, SECOND_TOO_LATE, STARS_ELSEWHERE, START_RATE, TIME_JUMP)
from startracker_ros.core.integrity.consistency import expected_stars, RowPattern
from startracker_ros.core.integrity.systematic_errors import epoch_covariance
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.registry import MODELS
from startracker_ros.core.track.bank import TrackBank
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.model import FrameUpdate, StarModel
from startracker_ros.core.track.new_stars import match_new_stars, zero_point
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.prediction import predict_stars, visible_stars
from startracker_ros.core.track.rotation_fit import median, OUTLIER_SIGMA, RotationFit
from startracker_ros.core.track.start import (
    fit_identified, HintedStart, IdentifiedFrame, Start, start_of_prediction, start_of_two)
from startracker_ros.core.track.tracks import Acceleration, Hint, TrackedAttitude, Tracks

RECENT_FRAMES = 64
"""Frames stored for an identification that comes late, and attitudes to check it by:
6 s at 10 Hz, several times the duration of a lost-in-space identification."""

# All are imported, so that a node loads their machine code before it is ready.
_MODELS = {name: model.load() for name, model in MODELS.items()}


class TrackerState(StrEnum):
    """States of the tracker."""

    LOST = 'LOST'
    ACQUIRING = 'ACQUIRING'
    TRACKING = 'TRACKING'


class TrackFilter:
    """
    Tracks identified stars through frames of centroids.

    LOST       -> ACQUIRING  an identified frame
    ACQUIRING  -> TRACKING   a second one within max_gap_s, at max_rate_deg_s at most
    any        -> TRACKING   an identified frame that agrees with a hint, unless TRACKING
               -> ACQUIRING  a second one at a higher rate, which becomes the first
               -> LOST       no second one within max_gap_s
    TRACKING   -> TRACKING   other stars than those followed, where the prediction has them
               -> ACQUIRING  an identified frame that contradicts the tracks
               -> LOST       max_bad_frames bad frames in a row, or max_gap_s without stars
    any        -> LOST       reset(), or time jumps back

    Feed update() with every frame and identified() with the identifications, in any
    interleaving: an identification may come some frames late or before its own update().
    add_rate() adds the rates of a gyro. acquire_new_stars() may follow update(). The attitude is
    that of the sensor in ICRF where motion is that of the observer; without one the observer is
    at rest. sky has the stars as that observer sees them.

    state and reason describe the last transition; contradiction is why the stars of the newest
    frame are no attitude although some agree, empty if they are; frames_since_fix counts the
    frames since the last good one, stars_matched its inliers, residual_px is their rms residual
    (NaN without any); late_frames counts frames rejected as older than the last one,
    rejected_centroids those without a finite position or a positive sigma, checks_passed the
    identifications that agreed with the tracks; hints has the newest hint.
    """

    def __init__(self, camera: Camera, onboard: OnboardCatalog,
                 options: TrackerOptions = TrackerOptions(),
                 gyro: GyroErrorOptions = GyroErrorOptions(),
                 motion: ObserverMotion | None = None) -> None:
        self._camera = camera
        self._onboard = onboard
        self.sky = ApparentSky(onboard, motion)
        # The attitude that was published last, by its estimate.
        self._icrf: tuple[AttitudeEstimate | None, AttitudeEstimate | None] = None, None
        self._options = options
        self._gyro_options = gyro
        self._stars = StarsInView(camera, onboard)
        self._unassociated: tuple[RotationFit, Centroids, np.ndarray] | None = None
        self._next_id = 1
        self.late_frames = 0
        self.rejected_centroids = 0
        self.checks_passed = 0
        self.reset()

    def reset(self) -> None:
        """Drop everything but the counts and the track numbers."""
        self._stamp_ns: int | None = None
        self._repetition = Repetition()
        self._recent: deque[tuple[int, Centroids]] = deque(maxlen=RECENT_FRAMES)
        self._gyro = Gyro(self._gyro_options)
        self.hints = HintedStart()
        self._history: deque[tuple[int, AttitudeEstimate]] = deque(maxlen=RECENT_FRAMES)
        self.frames_since_fix = 0
        self._enter(TrackerState.LOST, 'waiting for an identified frame')

    def set_limits(self, options: TrackerOptions) -> None:
        """Use live options, without loss of lock; the others must be those of before."""
        self._options = options
        self._model.set_limits(options)

    @property
    def attitude(self) -> TrackedAttitude | None:
        """Return the attitude of the newest frame, None unless its stars agree on one."""
        if not self._history or self._history[-1][0] != self._stamp_ns:
            return None
        estimate = self._history[-1][1]
        if self._icrf[0] is not estimate:
            self._icrf = estimate, self._with_systematic_errors(estimate)
        attitude = self._icrf[1]
        assert attitude is not None
        return TrackedAttitude(attitude, self._model.rate_rad_s, self._model.rate_covariance)

    @property
    def cross_covariance(self) -> np.ndarray | None:
        """Return that (3, 3) of the errors of attitude and rate, None where it is not known."""
        return self._model.cross_covariance

    @property
    def acceleration(self) -> Acceleration:
        """Return the angular acceleration at the last frame."""
        return self._model.acceleration

    @property
    def frame_attitude(self) -> AttitudeEstimate | None:
        """Return the attitude of the newest frame by its stars alone, of a model that has one."""
        measured = self._model.measured_attitude if self.attitude is not None else None
        return None if measured is None else self._with_systematic_errors(measured)

    @property
    def predicted(self) -> PredictedCentroids | None:
        """
        Return where the brightest stars in view, tracked or not, are at the newest frame.

        None unless TRACKING, or without an attitude.
        """
        if self.state is not TrackerState.TRACKING or self._bank_stamp_ns != self._stamp_ns:
            return None
        predicted = self._model.predicted or self.attitude
        if predicted is None:
            return None
        return predict_stars(self._stars, self._tracked_sky, self._stamp_ns, predicted.attitude,
                             predicted.rate_rad_s, self._options)

    @property
    def follows(self) -> bool:
        """Return whether the stars of the last frame were where the tracks have them."""
        return self.state is TrackerState.TRACKING and not self.frames_since_fix

    @property
    def gyro_trouble(self) -> str:
        """Return why the rates of a gyro are not used, empty where they are or without a gyro."""
        return self._model.gyro_trouble

    @property
    def stamp_sigma_s(self) -> float:
        """Return the standard deviation of the stamps, zero where unknown."""
        return self._model.stamp_sigma_s

    @property
    def gyro_condition(self) -> str:
        """Whether the rates of a gyro are used: none, used or unused."""
        return 'none' if not len(self._gyro) else 'used' if self._model.uses_gyro else 'unused'

    def warm_up(self) -> None:
        """Compile and load what a frame needs, with a second tracker of a synthetic field."""
        tracker = TrackFilter(self._camera, self._onboard, self._options)
        centroids, hip = synthetic_field(self._onboard, self._camera)
        # A gyro is used only after some frames.
        for stamp_ns in range(0, 10 ** 9, 10 ** 8):
            tracker.add_rate(stamp_ns, np.zeros(3))
            tracker.update(stamp_ns, centroids)
            tracker.identified(stamp_ns, centroids, hip)
        # As in a torn frame: stars seen elsewhere. The time grows as their number to the fourth.
        uv = centroids.uv[:8]
        expected_stars(uv, np.ones_like(uv), uv + 5.0, SECOND_IMAGE.limits['present_px'])

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Add a rate (3,) about sensor axes measured up to a time; False if it is rejected."""
        return self._gyro.add(stamp_ns, rate_rad_s)

    def add_hint(self, hint: Hint) -> None:
        """Use an attitude from elsewhere: one identified frame that agrees with it starts."""
        self.hints.add(hint)

    def update(self, stamp_ns: int, centroids: Centroids) -> Tracks | None:
        """
        Process a frame of centroids and return the tracks, empty unless TRACKING.

        Return None, and count a late frame, when its stamp is not newer than the last one.
        """
        if self._stamp_ns is not None and stamp_ns <= self._stamp_ns:
            back_s = (self._stamp_ns - stamp_ns) * 1e-9
            if back_s <= LATE_FRAME.limits['back_s']:
                self.late_frames += 1
                return None
            self.reset()
            self.reason = TIME_JUMP.diagnostic.format(back_s=back_s)
        frame = self._usable(centroids)[0]
        repeated = self._repetition.add(frame)
        if repeated:
            frame = Centroids.empty()
        self._stamp_ns = stamp_ns
        self._recent.append((stamp_ns, frame))
        self.frames_since_fix += 1
        if self._first is not None and self._gap_exceeded(self._first.stamp_ns, stamp_ns):
            self._enter(TrackerState.LOST, SECOND_TOO_LATE.diagnostic.format(
                max_gap_s=self._options.max_gap_s))
        if self.state is TrackerState.TRACKING and stamp_ns != self._bank_stamp_ns:
            self._track(stamp_ns, frame)
        if repeated and self.state is TrackerState.TRACKING:
            self.contradiction = REPEATED_FRAME.diagnostic
        elif repeated and self.state is TrackerState.LOST:
            self.reason = REPEATED_FRAME.diagnostic
        if self.state is not TrackerState.TRACKING or stamp_ns != self._bank_stamp_ns:
            return Tracks.empty()
        return self._model.bank.to_tracks(
            self._onboard,
            self._good_stamp_ns == self._bank_stamp_ns and not self.contradiction)

    def identified(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> None:
        """
        Process an identified frame: hip (N,) of each centroid, 0 where it is unknown.

        Frames with too few stars or a poor fit are ignored, and those that update() left out.
        """
        if any(stamp == stamp_ns and not len(recent) for stamp, recent in self._recent):
            return
        centroids, good = self._usable(centroids)
        sky = self.sky.at(stamp_ns)
        frame, misfit = fit_identified(self._camera, sky, self._options, stamp_ns, centroids,
                                       self._model.error_px2(centroids), np.asarray(hip)[good])
        if frame is None:
            if misfit and self.state is TrackerState.LOST:
                self.reason = misfit
            return
        if self.state is TrackerState.TRACKING:
            self._cross_check(frame, sky)
        elif (hinted := self.hints.start(frame, self._options.max_gap_s)) is not None:
            self._start(hinted)
        elif self._first is None or self._gap_exceeded(self._first.stamp_ns, stamp_ns):
            self._acquire(frame, f'first identification, {len(frame.star_index)} stars')
        elif stamp_ns > self._first.stamp_ns:
            self._start(start_of_two(self._first, frame))

    def acquire_new_stars(self) -> None:
        """
        Start tracks of stars that came into view in the last frame.

        The next update() calls it first. A call between two frames saves that time.
        """
        if self._unassociated is None:
            return
        (fit, frame, unassociated), self._unassociated = self._unassociated, None
        bank = self._model.bank
        vacant = self._options.max_stars - len(bank)
        if vacant <= 0 or not unassociated.any():
            return
        free = np.flatnonzero(unassociated)
        star_index, centroid = match_new_stars(
            self._stars, self._tracked_sky, fit.attitude, frame.uv[free], frame.flux[free],
            fit.scale * self._model.sigma_px(frame)[free], self._zero_point(bank),
            self._options.magnitude_tolerance)
        if not len(star_index):
            return
        new = np.flatnonzero(~(star_index[:, None] == bank.star_index).any(axis=1))[:vacant]
        if len(new):
            self._add_tracks(star_index[new], frame.select(free[centroid[new]]), confirmed=False)

    def _zero_point(self, bank: TrackBank) -> float:
        """Return the magnitude of 1 DN by the detected stars of a bank."""
        return zero_point(self._onboard.magnitude, bank.star_index, bank.detected, bank.flux)

    # --- transitions ---

    def _enter(self, state: TrackerState, reason: str) -> None:
        """Enter a state without tracks."""
        if state is TrackerState.LOST:
            self.hints.lost(len(self._history))
            self._seen: TrackBank | None = None
        self.state = state
        self.reason = reason
        self.stars_matched = 0
        self.residual_px = math.nan
        self._first: IdentifiedFrame | None = None
        self._elsewhere: IdentifiedFrame | None = None
        self._model = make_model(self._camera, self._options, self._gyro)
        self._unassociated = None
        self._pattern = RowPattern(self._camera)
        self.contradiction = ''
        self._before_ns: int = 0
        self._bank_stamp_ns: int = 0
        self._good_stamp_ns: int = 0
        self._bad_frames = 0
        self._history.clear()

    def _acquire(self, frame: IdentifiedFrame, reason: str) -> None:
        """Enter ACQUIRING with the first identified frame."""
        self._enter(TrackerState.ACQUIRING, reason)
        self._first = frame

    def _start(self, start: Start) -> None:
        """Enter TRACKING at an identified frame and process the frames since."""
        frame = start.frame
        rate_deg_s = np.degrees(np.linalg.norm(start.rate))
        if rate_deg_s > self._options.max_rate_deg_s:
            self._acquire(frame, START_RATE.diagnostic.format(rate_deg_s=rate_deg_s))
            return
        self._enter(TrackerState.TRACKING, start.reason)
        self.hints.started(start)
        self._model.start(start)
        self._stars.lens = self._model.lens
        most = slice(self._options.max_stars)
        self._add_tracks(frame.star_index[most], frame.centroids.select(most), confirmed=True)
        self._seen = self._model.bank
        self._bank_stamp_ns = self._good_stamp_ns = frame.stamp_ns
        self.stars_matched = len(frame.star_index)
        self.frames_since_fix = 0
        self._history.append((frame.stamp_ns, frame.attitude))
        for stamp_ns, recent in list(self._recent):
            if stamp_ns > frame.stamp_ns and self.state is TrackerState.TRACKING:
                self._track(stamp_ns, recent)

    def _cross_check(self, frame: IdentifiedFrame, sky: ApparentCatalog) -> None:
        """Compare an identified frame with the tracked attitude of its time, if there is one."""
        tracked = next((attitude for stamp_ns, attitude in self._history
                        if stamp_ns == frame.stamp_ns), None)
        if tracked is None:
            if frame.stamp_ns > self._good_stamp_ns and self._bad_frames:
                self._seen_elsewhere(frame)
            return
        if frame.contradicts(tracked, self._camera, sky, self._options.max_residual_px):
            error = attitude_error(frame.attitude.quaternion, tracked.quaternion)
            self._acquire(frame, IDENTIFICATION_DIFFERS.diagnostic.format(
                error_deg=np.degrees(np.linalg.norm(error))))
        else:
            self.checks_passed += 1

    def _seen_elsewhere(self, frame: IdentifiedFrame) -> None:
        """Start again at the second identified frame in a row that is unused: the body jumped."""
        first, self._elsewhere = self._elsewhere, frame
        if first is not None and first.stamp_ns < frame.stamp_ns:
            self._start(start_of_two(first, frame)._replace(
                reason=STARS_ELSEWHERE.diagnostic.format(
                    frames=self._bad_frames, stars=len(frame.star_index))))

    # --- from frame to frame ---

    def _track(self, stamp_ns: int, frame: Centroids) -> None:
        """Update the tracks by a newer frame."""
        if self._gap_exceeded(stamp_ns, self._good_stamp_ns):
            self._enter(TrackerState.LOST, NO_STARS.diagnostic.format(
                gap_s=(stamp_ns - self._good_stamp_ns) * 1e-9))
        if stamp_ns <= self._bank_stamp_ns or self.state is not TrackerState.TRACKING:
            return
        self.acquire_new_stars()
        self._before_ns, self._bank_stamp_ns = self._bank_stamp_ns, stamp_ns
        result = self._model.update(stamp_ns, frame, self._tracked_sky)
        frame = result.frame
        self._stars.lens = self._model.lens
        if self._model.failure:
            self._enter(TrackerState.LOST, self._model.failure)
            return
        self.contradiction = self._contradiction(result, frame) if result.good else ''
        if result.fit is None:
            self.stars_matched, self.residual_px = 0, math.nan
        else:
            self.stars_matched = int(np.count_nonzero(result.fit.inlier))
            self.residual_px = result.fit.residual_px
        if result.fit is not None and result.good:
            self._end_good_frame(stamp_ns, frame, result.fit)
            self._unassociated = result.fit, frame, result.unassociated
        else:
            self._end_bad_frame(frame)
            if self.state is TrackerState.TRACKING and not self._model.is_sparse(frame):
                self._resume(stamp_ns, frame)

    def _resume(self, stamp_ns: int, frame: Centroids) -> None:
        """
        Start anew by other stars than those followed, where enough are as predicted.

        Only in a fast turn, where faint stars leave the image before as many new ones count.
        Where those followed are seen and do not agree, the motion is not as predicted.
        """
        predicted = self._model.predicted
        if (predicted is None or self._seen is None or not self._crosses_fast(stamp_ns)
                or self._are_seen(frame)):
            return
        star_index, centroid = match_new_stars(
            self._stars, self._tracked_sky, predicted.attitude, frame.uv, frame.flux,
            self._model.sigma_px(frame), self._zero_point(self._seen),
            self._options.magnitude_tolerance)
        hip = np.zeros(len(frame), np.int64)
        hip[centroid] = self._onboard.hip[star_index]
        found, _ = fit_identified(self._camera, self._tracked_sky, self._options, stamp_ns, frame,
                                  self._model.error_px2(frame), hip)
        if found is None or self._misplaced(found.attitude, found.star_index, found.scale, frame):
            return
        start = start_of_prediction(
            Hint(stamp_ns, predicted.attitude.quaternion, predicted.attitude.covariance_sensor,
                 predicted.rate_rad_s, predicted.rate_covariance), found)
        if start is not None:
            before = self._model
            self._start(start)
            self._model.resume(before)

    def _crosses_fast(self, stamp_ns: int) -> bool:
        """Return whether stars leave the image within some frames of this interval."""
        x, y, _ = self._model.rate_rad_s
        interval_s = (stamp_ns - self._before_ns) * 1e-9
        moved_px = math.hypot(x, y) * self._camera.fx * interval_s
        return moved_px > FAST_TURN.limits['width_share'] * self._camera.width

    def _are_seen(self, frame: Centroids) -> bool:
        """Return whether enough of the stars followed have a centroid in the neighbourhood."""
        bank = self._model.bank
        away_px = np.linalg.norm(bank.uv[bank.confirmed][:, None] - frame.uv, axis=-1)
        seen = away_px.min(axis=1, initial=np.inf) < FAST_TURN.limits['neighbourhood_px']
        return bool(np.count_nonzero(seen) >= self._options.min_stars)

    def _end_good_frame(self, stamp_ns: int, frame: Centroids, fit: RotationFit) -> None:
        """Record the attitude, drop missed, blended and outlying stars, confirm new ones."""
        self._bad_frames, self._good_stamp_ns, self._elsewhere = 0, stamp_ns, None
        if not self.contradiction:
            self.frames_since_fix = 0
            self._history.append((stamp_ns, fit.attitude))
        bank = self._model.bank
        kept, confirmed, new = kept_after_fit(
            self._kept(frame), fit.normalised, OUTLIER_SIGMA, bank.missed, bank.age,
            bank.confirmed, self._options.confirm_frames)
        self._seen = (replace(bank, confirmed=confirmed) if new else bank).select(kept)
        self._model.bank = self._seen

    def _contradiction(self, result: FrameUpdate, frame: Centroids) -> str:
        """Return why not all of a frame shows the attitude that was found, empty if it does."""
        bank, fit = self._model.bank, result.fit
        assert fit is not None, 'a good frame has a fit'
        return self._misplaced(fit.attitude, bank.star_index[bank.detected], fit.scale, frame) or (
            self._pattern.find(result.residuals) if result.residuals else '')

    def _misplaced(self, attitude: AttitudeEstimate, detected: np.ndarray, scale: float,
                   frame: Centroids) -> str:
        """Return what speaks against an attitude among stars as bright as those detected (N,)."""
        present_px = max(SECOND_IMAGE.limits['present_px'],
                         OUTLIER_SIGMA * scale * median(self._model.sigma_px(frame)))
        expected, velocity = visible_stars(
            self._stars, self._tracked_sky, attitude, self._model.rate_rad_s,
            self._onboard.magnitude[detected].max())
        return expected_stars(expected, velocity, frame.uv, present_px)

    def _end_bad_frame(self, frame: Centroids) -> None:
        """Drop missed stars, and enter LOST after max_bad_frames."""
        # A sparse frame is no evidence against the tracks.
        self._bad_frames += not self._model.is_sparse(frame)
        self._model.bank = self._model.bank.select(self._kept(frame))
        if self._bad_frames >= self._options.max_bad_frames:
            self._enter(TrackerState.LOST, BAD_FRAMES.diagnostic.format(
                frames=self._bad_frames, stars=self.stars_matched, residual_px=self.residual_px))

    def _kept(self, frame: Centroids) -> np.ndarray:
        """Return the tracks (N,) that are not missed too often."""
        bank, sparse = self._model.bank, self._model.is_sparse(frame)
        return kept_tracks(self._tracked_sky.crowded(bank.star_index), bank.missed, bank.age,
                           bank.confirmed, math.inf if sparse else float(self._options.max_missed))

    def _add_tracks(self, star_index: np.ndarray, centroids: Centroids, *, confirmed: bool
                    ) -> None:
        track_id = np.arange(self._next_id, self._next_id + len(star_index))
        self._next_id += len(star_index)
        self._model.add(track_id, star_index, centroids, confirmed=confirmed)

    @property
    def _tracked_sky(self) -> ApparentCatalog:
        """Return the stars as the observer saw them in the frame of the tracks."""
        return self.sky.at(self._bank_stamp_ns)

    def _with_systematic_errors(self, estimate: AttitudeEstimate) -> AttitudeEstimate:
        sky, bank = self._tracked_sky, self._model.bank
        budget = self._model.budget(
            estimate.covariance_sensor, sky.observer.velocity_sigma_m_s)
        if sky.observer.epoch_sigma_years:
            seen = bank.detected
            budget = budget._replace(epoch=epoch_covariance(
                estimate.quaternion, sky.observer.epoch_sigma_years,
                self._camera.unproject(bank.uv[seen]),
                self._camera.pixel_rad * np.sqrt(bank.variance[seen]),
                sky.motion(bank.star_index[seen])))
        return AttitudeEstimate(estimate.quaternion, budget.covariance, estimate.stars,
                                estimate.residual_rad, estimate.chi2, budget)

    def _gap_exceeded(self, stamp_ns: int, other_ns: int) -> bool:
        return abs(stamp_ns - other_ns) * 1e-9 > self._options.max_gap_s

    def _usable(self, centroids: Centroids) -> tuple[Centroids, np.ndarray]:
        """Return the centroids with finite position and positive sigma, and their mask (N,)."""
        good, rejected = usable_centroids(
            *map(np.ascontiguousarray, (centroids.uv, centroids.sigma_px)))
        self.rejected_centroids += rejected
        return centroids.select(good) if rejected else centroids, good


def make_model(camera: Camera, options: TrackerOptions, gyro: Gyro) -> StarModel:
    """Return the model that the options name."""
    model: StarModel = _MODELS[options.model](camera, options, gyro)
    return model


# --- frames of a source that is frozen: two exposures never have the same noise ---


class Repetition:
    """Compares each frame of centroids with the one before it that has any."""

    def __init__(self) -> None:
        self._before = np.empty((0, 2))
        self._vary = False

    def add(self, frame: Centroids) -> bool:
        """
        Add a frame; return whether it is the one before, of a source whose frames have differed.

        A frame that is shown again and again from the start is no fault.
        """
        if not len(frame):
            return False
        # A caller may use the same array again.
        before, self._before = self._before, frame.uv.copy()
        if len(before) and not self._vary:
            brightest_px = np.linalg.norm(before - frame.uv[0], axis=1).min()
            self._vary = bool(brightest_px > REPEATED_FRAME.limits['moved_px'])
        return self._vary and np.array_equal(before, frame.uv)


# --- which centroids are used, which tracks are kept: compiled ---


@compiled
def usable_centroids(uv: np.ndarray, sigma_px: np.ndarray) -> tuple[np.ndarray, int]:
    """Return which centroids (N,) have a finite position and a positive sigma; how many not."""
    good, rejected = np.empty(len(uv), np.bool_), 0
    for n in range(len(uv)):
        good[n] = (np.isfinite(uv[n, 0]) and np.isfinite(uv[n, 1])
                   and np.isfinite(sigma_px[n]) and sigma_px[n] > 0)
        rejected += not good[n]
    return good, rejected


@compiled
def kept_tracks(crowded: np.ndarray, missed: np.ndarray, age: np.ndarray, confirmed: np.ndarray,
                most_missed: float) -> np.ndarray:
    """
    Return which tracks (N,) are kept: not near a planet, and not missed too often.

    Confirmed ones may be missed in most_missed frames in a row, new ones in half of their age.
    """
    kept = np.empty(len(missed), np.bool_)
    for n in range(len(missed)):
        kept[n] = not crowded[n] and missed[n] <= (most_missed if confirmed[n] else age[n] // 2)
    return kept


@compiled
def kept_after_fit(kept: np.ndarray, normalised: np.ndarray, most_sigmas: float,
                   missed: np.ndarray, age: np.ndarray, confirmed: np.ndarray, confirm_frames: int
                   ) -> tuple[np.ndarray, np.ndarray, int]:
    """
    Return which tracks (N,) are kept after a fit, which are confirmed, and how many are new.

    normalised (N,) are the residuals in sigma: an outlier is not kept. A track seen in this frame
    is confirmed from an age of confirm_frames on.
    """
    left, after, new = np.empty(len(kept), np.bool_), np.empty(len(kept), np.bool_), 0
    for n in range(len(kept)):
        seen = missed[n] == 0
        left[n] = kept[n] and not (seen and normalised[n] > most_sigmas)
        after[n] = confirmed[n] or (seen and age[n] >= confirm_frames)
        new += after[n] and not confirmed[n]
    return left, after, new
