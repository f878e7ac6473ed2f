# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The filter of the tracks: from identified frames of stars to tracks of stars."""

from enum import StrEnum

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.attitude.result import AttitudeEstimate, SOLVERS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentSky
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.integrity.reasons import reason_text
from startracker_ros.core.native_tracker import (
    attitude_of, MOST_CENTROIDS, native_centroids, native_identified, set_options, SkyTracker,
    TRACKS)
from startracker_ros.core.registry import MODELS
from startracker_ros.core.track.options import ASSOCIATIONS, TrackerOptions
from startracker_ros.core.track.tracks import Acceleration, Hint, TrackedAttitude, Tracks

MOST_TRACKS, MOST_RATES = 500, 100_000
"""Capacities, those of the largest options: what is not used takes no memory."""

_CHOICES = {'model': tuple(MODELS), 'solver': SOLVERS, 'association': ASSOCIATIONS}
_CONDITIONS = 'none', 'used', 'unused'
_NOT_NEWER, _WAITING = 11, 300  # ST_NOT_NEWER, ST_REASON_WAITING
_COUNTS = 'late_frames', 'rejected_centroids', 'checks_passed'


class TrackerState(StrEnum):
    """States of the tracker."""

    LOST = 'LOST'
    ACQUIRING = 'ACQUIRING'
    TRACKING = 'TRACKING'


_STATES = tuple(TrackerState)


def _fields(struct: np.ndarray, first: str, last: str, kind: type) -> np.ndarray:
    """Return a view of the fields of one kind from the first to the last."""
    fields = dict(struct.dtype.fields or {})
    places = [fields[name][1] for name in (first, last)]
    size = np.dtype(kind).itemsize
    return struct.reshape(1).view(np.uint8)[places[0]:places[1] + size].view(kind)


class TrackFilter:
    """
    Tracks identified stars through frames of centroids, by the native library.

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
    at rest. sky has the stars as that observer sees them. tracker is one that does more than
    tracking, which fills in tracking.

    state and reason describe the last transition; contradiction is why the stars of the newest
    frame are not an attitude although some agree, empty if they are; frames_since_fix counts the
    frames since the last good one, stars_matched its inliers, residual_px is their rms residual
    (NaN without any); late_frames counts frames rejected as older than the last one,
    rejected_centroids those without a finite position or a positive sigma, checks_passed the
    identifications that agreed with the tracks; newest_hint is the newest hint.
    """

    def __init__(self, camera: Camera, onboard: OnboardCatalog,
                 options: TrackerOptions = TrackerOptions(),
                 gyro: GyroErrorOptions = GyroErrorOptions(),
                 motion: ObserverMotion | None = None, tracker: SkyTracker | None = None,
                 tracking: np.ndarray | None = None) -> None:
        self.sky = ApparentSky(onboard, motion)
        if tracker is None:
            config = native.defaults()
            config['stages'] = TRACKS
            set_tracking(config, options, gyro)
            tracker = SkyTracker(config, camera, onboard, motion)
        self._tracker = tracker
        self._tracking = np.zeros((), native.TRACKING) if tracking is None else tracking
        self._hint = np.zeros((), native.HINT)
        self._tracking_at = self._tracking.ctypes.data
        # Fields next to each other, which are read at once.
        self._whole = _fields(self._tracking, 'state', 'checks_passed', np.int32)
        self._figures = _fields(self._tracking, 'residual_px', 'stamp_sigma_s', np.float64)
        self.reset()

    def reset(self) -> None:
        """Drop everything but the counts and the track numbers."""
        self._tracker.reset()
        counts = {name: int(self._tracking[name]) for name in _COUNTS}
        self._tracking[()] = np.zeros((), native.TRACKING)
        self._tracking['reason']['code'], self._tracking['residual_px'] = _WAITING, np.nan
        for name, count in counts.items():
            self._tracking[name] = count
        self.newest_hint: Hint | None = None
        self._stamp_ns: int | None = None
        self.look()

    def set_limits(self, options: TrackerOptions) -> None:
        """Use live options, without loss of lock; the others must be those of before."""
        set_options(self._tracker.config['tracking'], options, **_CHOICES)
        self._tracker.change_options()

    # --- what goes in ---

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Add a rate (3,) about sensor axes measured up to a time; False if it is rejected."""
        rate = np.array(rate_rad_s, float)
        return not self._tracker.status_of('st_add_rate', stamp_ns, rate.ctypes.data)

    def add_hint(self, hint: Hint) -> None:
        """Use an attitude from elsewhere: one identified frame that agrees with it starts."""
        self.newest_hint = hint
        self._hint[()] = tuple(hint)
        self._tracker.status_of('st_add_hint', self._hint.ctypes.data)

    def update(self, stamp_ns: int, centroids: Centroids) -> Tracks | None:
        """
        Process a frame of centroids and return the tracks, empty unless TRACKING.

        Return None, and count a late frame, when its stamp is not newer than the last one.
        """
        self._tracker.look(stamp_ns)
        table = native_centroids(centroids)
        exposure_s = np.array(centroids.exposure_s)
        status = self._tracker.status_of(
            'st_track', stamp_ns, table.ctypes.data, len(table), exposure_s.ctypes.data,
            self._tracking_at)
        if status == _NOT_NEWER:
            self.look()
            return None
        native.check(status)
        self.look(stamp_ns)
        return self.tracks

    def identified(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray) -> None:
        """
        Process an identified frame: hip (N,) of each centroid, 0 where it is unknown.

        Frames with too few stars or a poor fit are ignored, and those that update() left out.
        """
        self._tracker.look(stamp_ns)
        table = native_centroids(centroids)
        identified = native_identified(hip, len(table))
        self._tracker.call('st_add_identification', stamp_ns, table.ctypes.data,
                           identified.ctypes.data, len(table), self._tracking_at)
        self.look()

    def acquire_new_stars(self) -> None:
        """
        Start tracks of stars that came into view in the last frame.

        The next update() calls it first. A call between two frames saves that time.
        """
        self._tracker.call('st_prepare')

    # --- what is known ---

    def look(self, stamp_ns: int | None = None, kept: np.ndarray | None = None) -> None:
        """
        Take the figures of the last call; with the stamp of a frame that it was of.

        kept is a copy of its TRACKING where there is one.
        """
        if stamp_ns is not None:
            self._stamp_ns = stamp_ns
        (state, gyro, *_, self.stars_matched, self.frames_since_fix, self.late_frames,
         self.rejected_centroids, self.checks_passed) = self._whole.tolist()
        self.state, self.gyro_condition = _STATES[state], _CONDITIONS[gyro]
        self.residual_px, self.stamp_sigma_s = self._figures.tolist()
        self._kept = kept
        self._attitude: TrackedAttitude | None = None

    def look_again(self) -> None:
        """Take what is known after an identification that is part of a call for a frame."""
        self._tracker.call('st_known', self._tracking_at)
        self.look()

    @property
    def kept(self) -> np.ndarray:
        """Return the TRACKING of the last call, which stays."""
        if self._kept is None:
            self._kept = self._tracking.copy()
        return self._kept

    @property
    def reason(self) -> str:
        """Return why the state is this one."""
        return reason_text(self._tracking['reason'])

    @property
    def contradiction(self) -> str:
        """Return why the stars of the newest frame are not an attitude although some agree."""
        return reason_text(self._tracking['contradiction'])

    @property
    def gyro_trouble(self) -> str:
        """Return why the rates of a gyro are not used, empty where they are."""
        return reason_text(self._tracking['gyro_trouble'])

    @property
    def tracks(self) -> Tracks:
        """Return the tracks of the newest frame."""
        return Tracks.of(self._tracker.listed('st_tracks', native.STAR_TRACK))

    @property
    def attitude(self) -> TrackedAttitude | None:
        """Return the attitude of the newest frame, None unless its stars agree on one."""
        if self._attitude is None and self._tracking['attitude']['valid']:
            attitude = self.kept['attitude']
            self._attitude = TrackedAttitude(
                attitude_of(attitude, self.kept['budget']), attitude['rate_rad_s'],
                attitude['rate_covariance'])
        return self._attitude

    @property
    def cross_covariance(self) -> np.ndarray | None:
        """Return that (3, 3) of the errors of attitude and rate, None where it is not known."""
        cross = self.kept['attitude']['cross_covariance']
        return None if np.isnan(cross[0, 0]) else cross

    @property
    def acceleration(self) -> Acceleration:
        """Return the angular acceleration at the last frame."""
        attitude = self.kept['attitude']
        return Acceleration(*(attitude[name] for name in (
            'acceleration_rad_s2', 'acceleration_sigma_rad_s2', 'jerk_rad_s3',
            'acceleration_sigma_before_rad_s2')))

    @property
    def frame_attitude(self) -> AttitudeEstimate | None:
        """Return the attitude of the newest frame by its stars alone, of a model that has one."""
        attitude = self.kept['frame_attitude']
        return attitude_of(attitude, self.kept['frame_budget']) if attitude['valid'] else None

    @property
    def predicted(self) -> PredictedCentroids | None:
        """
        Return where the brightest stars in view, tracked or not, are at the newest frame.

        None unless TRACKING, or without an attitude.
        """
        table = self._tracker.listed('st_predictions', native.PREDICTION, none=True)
        if table is None or self._stamp_ns is None:
            return None
        columns = table.view(float).reshape(len(table), table.itemsize // 8)
        return PredictedCentroids(
            self._stamp_ns, columns[:, :2].copy(), columns[:, 2:4].copy(), columns[:, 4].copy(),
            table['hip'].copy(), len(table))

    @property
    def follows(self) -> bool:
        """Return whether the stars of the last frame were where the tracks have them."""
        return self.state is TrackerState.TRACKING and not self.frames_since_fix


def set_tracking(config: np.ndarray, options: TrackerOptions, gyro: GyroErrorOptions) -> None:
    """Set options of a CONFIG, with room for any change of those that are live."""
    capacities = config['capacities']
    capacities['centroids'], capacities['tracks'] = MOST_CENTROIDS, MOST_TRACKS
    capacities['rates'] = MOST_RATES
    set_options(config['gyro'], gyro)
    set_options(config['tracking'], options, **_CHOICES)
