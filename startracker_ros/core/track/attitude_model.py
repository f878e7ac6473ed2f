# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One rotation moves all stars: one filter of attitude and rate, updated by all of them."""

from collections.abc import Iterator
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.error_budget import ErrorBudget, NO_ERROR
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.attitude.gyro import Gyro, rate_text
from startracker_ros.core.attitude.result import pointing_covariance, WRONG_SIGMAS
from startracker_ros.core.camera.lens import Lens
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.integrity.checks import (
    DISPLACED, DIVERGED, ERROR_SCALE, FILTER_COVARIANCE, GYRO_AT_RANGE, GYRO_BLIND, GYRO_DIFFERS,
    GYRO_SILENT, INNOVATION, JUMP_IN_FRAME, LIKELY_INNOVATION, MOTION_ENDS, SHEARED_STARS)
from startracker_ros.core.integrity.consistency import Residuals
from startracker_ros.core.integrity.gyro_agreement import GyroAgreement
from startracker_ros.core.integrity.lens_error import LensError
from startracker_ros.core.integrity.stamp_jitter import StampJitter
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.small_algebra import is_positive_definite
from startracker_ros.core.track.correction import correct, Correction
from startracker_ros.core.track.followed_stars import followed, Measured
from startracker_ros.core.track.model import FrameUpdate, StarModel
from startracker_ros.core.track.motion_filter import (
    course, interrupted, lacking, MISSED_LIGHT, Motion, of_vibration, predicted, restarted,
    resumed, SMOOTH, started, state_of, SUDDEN, tail_sigmas, updated, WIDE, with_measured,
    with_tails)
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rolling_shutter import at_frame_time
from startracker_ros.core.track.rotation_fit import is_good, RAYLEIGH_MEDIAN, RotationFit
from startracker_ros.core.track.start import Start
from startracker_ros.core.track.tracks import Acceleration, TrackedAttitude

LIKELY = LIKELY_INNOVATION.threshold

STREAK_PX = 15.0
"""Length of a streak from which on a fit sees rather its ends; computed for a width of 1 px."""

SHEARED = SHEARED_STARS.limits['stars']
LARGE, SMALL, LEAST = (ERROR_SCALE.limits[name] for name in ('large', 'small', 'least'))
LINE_TIME_SIGMA, LEAST_LINE_TIME_SIGMA = 0.1, 0.0003  # of line_time_us: first frame, later

ACROSS = 0.03  # of a jump: the same across it, as the direction is not certain
UNSEEN = 0.02  # share of the light of a star that is elsewhere and does not show

GYRO_SILENCE_S = GYRO_SILENT.limits['age_s']


_NOTHING = Measured(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), np.empty(0),
                    np.empty((0, 2, 2)))
"""The centroids of a frame that is not used."""


class _Hypothesis(NamedTuple):
    """
    A predicted state, by a gyro or not.

    motion is what it is the mixture of, or a part of it, None where the gyro alone propagates the
    state. The innovation of the frame is to be within a gate.
    """

    uses_gyro: bool
    state: AttitudeState
    motion: Motion | None
    gate: float = INNOVATION.threshold

    @property
    def acceleration(self) -> np.ndarray:
        """Return the mean angular acceleration (3,) rad/s^2, zero where it is not known."""
        return np.zeros(3) if self.motion is None else _acceleration_of(self.motion)


class _Jump(NamedTuple):
    """What a jump has moved the attitude by, (3,), after a rate (3,); left counts frames."""

    rate: np.ndarray
    moved: np.ndarray
    left: int

    def is_displaced(self, state: AttitudeState, covariance: np.ndarray) -> bool:
        """Return whether the body turns as before the jump, covariance (6, 6)."""
        change = state.rate - self.rate
        return self.left > 0 and bool(
            change @ np.linalg.solve(covariance[3:, 3:], change) < DISPLACED.threshold)

    def later(self) -> '_Jump':
        """Return that of the next frame."""
        return self._replace(left=self.left - 1)


_Explanation = tuple[_Hypothesis, Correction]


class AttitudeModel(StarModel):
    """
    Predicts every star by attitude and body rate, or with a gyro by attitude and gyro drift.

    gyro_trouble is the reason why the rates of a gyro are not used, empty without one.
    """

    def __init__(self, camera: Camera, options: TrackerOptions, gyro: Gyro) -> None:
        super().__init__(camera, options)
        self._gyro = gyro
        self._acceleration_rad_s2 = options.acceleration_rad_s2
        self.gyro_trouble = self.failure = ''
        # Its figures are read before the first start.
        self._stamp_jitter = StampJitter()
        self._motion: Motion

    def start(self, start: Start) -> None:
        frame = start.frame
        covariance = np.zeros((9, 9))
        covariance[:3, :3] = frame.attitude.covariance_sensor * frame.scale ** 2
        covariance[:3, 3:6], covariance[3:6, :3] = start.cross, start.cross.T
        covariance[3:6, 3:6] = start.rate_covariance
        self._state = AttitudeState(
            frame.stamp_ns, frame.attitude.quaternion, start.rate, np.zeros(3), covariance
        ).with_new_drift(self._gyro.drift_sigma_rad_s)
        self.uses_gyro = False
        self._agreement = GyroAgreement(self._gyro)
        self._diverged = 0
        self._scale = _ErrorScale(frame.scale)
        self._lens_error = LensError(self._camera)
        self._stamp_jitter = StampJitter()
        interval_s = float(covariance[0, 0] / start.cross[0, 0]) if start.cross.any() else 0.0
        self._set_motion(started(self._state, np.diag(covariance)[:3].copy(), interval_s), False)
        self._measured: AttitudeEstimate | None = None
        self._common = NO_ERROR
        self._frames, self._shutter_rad = 0, np.zeros(3)
        self._jump: _Jump | None = None

    def resume(self, before: StarModel) -> None:
        if isinstance(before, AttitudeModel):
            self._motion = interrupted(resumed(self._motion, before._motion))

    def update(self, stamp_ns: int, frame: Centroids, sky: ApparentCatalog) -> FrameUpdate:
        """Update by the first hypothesis that the stars confirm, or keep the nominal one."""
        sparse = self.is_sparse(frame)
        icrf = sky.direction(self.bank.star_index)
        variance = (self._scale.value * self.sigma_px(frame)) ** 2
        error_px2 = self.error_px2(frame)
        common = (pointing_covariance(frame.correlated_error, self._camera, self._state.rate)
                  if frame.common.any() else NO_ERROR)
        if not self._motion.interval_s:
            self._motion = self._motion._replace(
                interval_s=(stamp_ns - self._motion.stamp_ns) * 1e-9)
        nominal, confirmed = self._explained(
            stamp_ns, frame, icrf, self._scale.value ** 2 * error_px2, common)
        if confirmed is not None:
            hypothesis, correction = confirmed
            before, was_used, self._common = self._state, self.uses_gyro, common
            self._set_motion(self._corrected(hypothesis, correction, frame, common),
                             hypothesis.uses_gyro)
            self._doubt_jump(before, hypothesis, frame)
            self._doubt_shutter(correction)
            fit = self._fit(correction)
            self._stamp_jitter.add(before, hypothesis.state, self._state, correction.turn,
                                   correction.turn_covariance + common)
            frame = at_frame_time(
                self._camera, frame, self._state.rate, _acceleration_of(self._motion))
            seen, residuals = self._follow(correction, icrf, Measured(
                frame.uv, frame.flux, frame.snr, frame.sigma_px, variance, error_px2))
            least_px = self._scale.value * frame.sigma_px.min()
            self._scale.add(correction.typical, correction.precise,
                            least_px <= self._options.sigma_floor_px)
            if self._lens_error.add(seen, residuals):
                self._scale.restart()
            self._diverged = 0
            self._check_covariance()
            self._compare_gyro(before.stamp_ns, was_used)
            return FrameUpdate(True, fit, frame, correction.unassociated, residuals)
        assert nominal is not None, 'there is always a hypothesis'
        # Propagate without an update: every star counts as missed.
        hypothesis, correction = nominal
        self._stamp_jitter.interrupt()
        self._set_motion(interrupted(
            hypothesis.motion or restarted(self._motion, hypothesis.state)),
                         hypothesis.uses_gyro)
        count = len(correction.predicted)
        self._follow(correction._replace(probability=np.ones((count, 1)),
                                         distance=np.full(count, np.inf)), icrf, _NOTHING)
        beyond = float(np.linalg.norm(correction.innovation))
        self._diverged = self._diverged + 1 if beyond > DIVERGED.sigmas else 0
        if self._diverged >= DIVERGED.frames:
            self.failure = DIVERGED.diagnostic.format(
                frames=self._diverged, sigmas=DIVERGED.sigmas, last=beyond)
        if sparse and hypothesis.uses_gyro and self._is_saturated(stamp_ns):
            self.failure = GYRO_BLIND.diagnostic
        self._check_covariance()
        return FrameUpdate(False, None, at_frame_time(
            self._camera, frame, hypothesis.state.rate, hypothesis.acceleration),
                           correction.unassociated)

    def _explained(self, stamp_ns: int, frame: Centroids, icrf: np.ndarray, error: np.ndarray,
                   common: np.ndarray) -> tuple[_Explanation | None, _Explanation | None]:
        """
        Return the first hypothesis that the stars contradict and the first one they confirm.

        Stars icrf (N, 3), centroids of covariance error (M, 2, 2), common that of all (3, 3).
        """
        sparse = self.is_sparse(frame)
        nominal: _Explanation | None = None
        confirmed: _Explanation | None = None
        for hypothesis in self._hypotheses(stamp_ns, sparse):
            correction = self._correction(hypothesis, frame, icrf, error, common)
            explanation = hypothesis, correction
            if not self._is_consistent(correction, hypothesis.gate):
                nominal = nominal or explanation
                if sparse:
                    break
                continue
            if correction.innovation @ correction.innovation > LIKELY:
                # Far from the prediction gates are wide: the stars are associated again from here.
                hypothesis = hypothesis._replace(state=correction.state)
                again = self._correction(hypothesis, frame, icrf, error, common)
                if again.agreed:
                    explanation = hypothesis, again
            if confirmed is not None and _inliers(correction) < _inliers(confirmed[1]) + SHEARED:
                continue
            nominal, confirmed = nominal or confirmed, explanation
            if not frame.delay_s.any() or correction.stars - _inliers(correction) < SHEARED:
                break
        return nominal, confirmed

    def _correction(self, hypothesis: _Hypothesis, frame: Centroids, icrf: np.ndarray,
                    error: np.ndarray, common: np.ndarray) -> Correction:
        """Return a predicted state corrected by a frame, with the arguments of _explained()."""
        predicted = _with_error(hypothesis.state, common)
        return correct(
            self.lens, icrf, self.bank.confirmed, self._options.min_stars, predicted,
            np.ascontiguousarray(at_frame_time(
                self._camera, frame, predicted.rate, hypothesis.acceleration).uv), error,
            frame.delay_s,
            self._detection)

    def _check_covariance(self) -> None:
        """Set the failure of a state whose covariance is none."""
        covariance = self._state.covariance
        variances = np.diagonal(covariance).tolist()
        if not (math.isfinite(covariance.sum()) and min(variances) > 0
                and is_positive_definite(covariance)):
            self.failure = FILTER_COVARIANCE.diagnostic.format(variances=variances)

    def _is_saturated(self, stamp_ns: int) -> bool:
        """Return whether the gyro reached its range within GYRO_SILENCE_S before a time."""
        return self._gyro.is_saturated(stamp_ns, GYRO_SILENCE_S)

    def _hypotheses(self, stamp_ns: int, sparse: bool) -> Iterator[_Hypothesis]:
        """Yield the nominal prediction, that of the gyro alone, then those of jumps."""
        state, gyro = self._state, self._gyro
        with_gyro = self.uses_gyro and gyro.silent_s(stamp_ns) <= GYRO_SILENCE_S and (
            sparse or not self._is_saturated(stamp_ns))
        motion = self._predicted(stamp_ns, with_gyro)
        # Of another motion than before the modes know less than the gyro, which integrates it. In
        # a sparse frame no assumption about the acceleration holds.
        goes_on = motion.weight[np.argmax(self._motion.weight)] > MOTION_ENDS.probability
        if not with_gyro or (goes_on and not sparse):
            yield _Hypothesis(with_gyro, state_of(motion), motion)
        if with_gyro:
            yield _Hypothesis(True, gyro.propagate(state, stamp_ns), None)
            motion = self._predicted(stamp_ns, False)
        for mode in WIDE:
            yield _Hypothesis(False, state_of(motion, mode), motion,
                              INNOVATION.threshold if mode is WIDE[-1] else LIKELY)

    def _predicted(self, stamp_ns: int, with_gyro: bool) -> Motion:
        """Return the motion at a time, by the rates of the gyro or without."""
        dt_s = np.array([(stamp_ns - self._motion.stamp_ns) * 1e-9])
        rates, variance = np.empty((0, 3)), np.empty(0)
        if with_gyro:
            dt_s, rates, variance = self._gyro.rates(self._motion.stamp_ns, stamp_ns)
        return predicted(self._motion, stamp_ns, dt_s, rates, variance, self._acceleration_rad_s2,
                         np.full(3, self._gyro.drift_density))

    def _corrected(self, hypothesis: _Hypothesis, correction: Correction, frame: Centroids,
                   common: np.ndarray) -> Motion:
        """Return the motion after a frame, and set the attitude that its stars measure."""
        state = hypothesis.state
        self._measured = AttitudeEstimate(
            turned(state.quaternion, correction.turn), correction.turn_covariance + common, 0,
            np.empty(0), 0.0)
        if hypothesis.motion is None:
            motion = restarted(self._motion, _with_error(correction.state, common))
        else:
            # An acceleration shows in rows, less the one that was assumed, and in streaks.
            by_acceleration = correction.by_acceleration.copy()
            moved = by_acceleration @ hypothesis.acceleration
            by_acceleration[:3] += self._by_streaks(frame, state.rate)
            # The stars show the pointing up to the error that they share, however the body moved.
            motion = _with_turns(updated(
                _with_turns(hypothesis.motion, common), state.quaternion, state.rate,
                correction.information, correction.vector, by_acceleration, moved), common)
        return with_measured(motion, self._motion.stamp_ns, self._measured.quaternion,
                             correction.turn_covariance)

    def _by_streaks(self, frame: Centroids, rate: np.ndarray) -> np.ndarray:
        """
        Return by what (3, 3) an acceleration turns streaks from the mean pointing, in s^2.

        The fit of a long streak sees its ends, whose middle is T^2 / 8 - T^2 / 24 of the
        acceleration away, along the motion.
        """
        speed2 = float(rate @ rate)
        if not frame.are_streaks or not speed2:
            return np.zeros((3, 3))
        exposure_s = min(frame.exposure_s[1], self._motion.interval_s)
        length_px = self._camera.fx * math.hypot(rate[0], rate[1]) * exposure_s
        share = 1 / (1 + (STREAK_PX / max(length_px, 1e-9)) ** 2)
        along: np.ndarray = (share * exposure_s ** 2 / 12 / speed2) * np.outer(rate, rate)
        return along

    def _doubt_jump(self, before: AttitudeState, hypothesis: _Hypothesis, frame: Centroids
                    ) -> None:
        """
        Add what a motion that begins within the frame may have done, or what else it may be.

        Stars whose light jumps within the exposure are not seen at its mean, and rows of a rolling
        shutter are exposed before and after. A frame whose stamp errs looks like a jump as well.
        """
        if hypothesis.motion is None:
            return
        sudden = float(self._motion.weight[SUDDEN].sum())
        interval_s = (self._state.stamp_ns - before.stamp_ns) * 1e-9
        doubt = sudden * max(min(frame.exposure_s[1] / interval_s, 1.0), JUMP_IN_FRAME.probability)
        own = np.ascontiguousarray(self._covariance[:3, :3])
        displaced = self._jump
        if displaced is not None and not displaced.is_displaced(self._state, self._covariance):
            displaced = None
        jumps = displaced is None and self._motion.weight[SMOOTH].sum() < 0.5
        if jumps or doubt > 2 * MISSED_LIGHT:
            moved = rotation_between(
                state_of(hypothesis.motion).quaternion, self._state.quaternion)
            self._covariance[:3, :3] += lacking(
                own, moved, ACROSS * _across(moved, before.rate), doubt)
            if jumps:
                self._jump = _Jump(before.rate, moved, DISPLACED.frames)
        if displaced is not None:
            self._covariance[:3, :3] += lacking(own, displaced.moved, 0.0, 1.0)
            self._jump = displaced.later()
        if self._jump is not None:
            self._covariance[:3, :3] += _unseen(
                self._jump, float(self._motion.share[SUDDEN].sum()))
        if frame.delay_s.any():
            spread_s = math.sqrt(np.mean(frame.delay_s ** 2))
            change = self._state.rate - before.rate
            error = np.concatenate([spread_s * change, change / 2])
            self._covariance += sudden * np.outer(error, error)

    def _doubt_shutter(self, correction: Correction) -> None:
        """
        Set the turn (3,) by 1 sigma of an error of line_time_us, and add its error of the rate.

        Such an error is one of the rate that brings the rows to one time, by the same share. The
        more frames there are, the smaller is one that their rows do not show.
        """
        if len(correction.vector) > 3:
            information = correction.information
            error = self._state.rate * max(
                LINE_TIME_SIGMA / (self._frames + 1) ** 2, LEAST_LINE_TIME_SIGMA)
            self._shutter_rad = np.linalg.solve(
                information[:3, :3], information[:3, 3:] @ error)
            self._covariance[3:, 3:] += np.outer(error, error)
        self._frames += 1

    def _is_consistent(self, correction: Correction, gate: float) -> bool:
        """Return whether the fit of the inliers is good and its innovation within the gate."""
        return (correction.agreed
                and bool(correction.innovation @ correction.innovation <= gate)
                and is_good(_inliers(correction), correction.stars,
                            correction.residual_px, self._options.min_stars,
                            self._options.max_residual_px))

    def _fit(self, correction: Correction) -> RotationFit:
        """Return the fit of the inliers, which gave the state."""
        inlier = correction.inlier
        attitude = AttitudeEstimate(
            self._state.quaternion, self._covariance[:3, :3], int(np.count_nonzero(inlier)),
            correction.distance[inlier] * self._camera.pixel_rad, correction.chi2)
        return RotationFit(attitude, correction.normalised, self._scale.value, inlier,
                           correction.residual_px)

    def _follow(self, correction: Correction, icrf: np.ndarray, measured: Measured
                ) -> tuple[np.ndarray, Residuals]:
        """
        Associate the tracks in the image, of directions (N, 3), where the state has them.

        Return the catalogue entries (D,) of the detected stars and their residuals.
        """
        bank = self.bank.select(correction.inside)
        if bank is not self.bank:
            icrf = icrf[correction.inside]
        after = followed(
            self.lens, self._state, icrf, bank.variance, bank.missed, bank.confirmed,
            correction.predicted, correction.probability, correction.distance, correction.best,
            measured)
        self.bank = bank.with_association(after.track, after.covariance, after.association)
        return bank.star_index[after.detected], after.residuals

    def _set_motion(self, motion: Motion, uses_gyro: bool) -> None:
        """Set the motion; where the use of the gyro ends its drift becomes unknown."""
        if self.uses_gyro and not uses_gyro:
            motion = restarted(self._motion, state_of(motion).with_new_drift(
                self._gyro.drift_sigma_rad_s))
        self._motion, self.uses_gyro = motion, uses_gyro
        self._state = state_of(motion)
        self._covariance = with_tails(
            motion, self._state.covariance[:6, :6] + of_vibration(motion))

    def budget(self, own: np.ndarray, velocity_sigma_m_s: float) -> ErrorBudget:
        """Return the same, with what the filter has for motions and shaking beside the stars."""
        budget = super().budget(own, velocity_sigma_m_s)._replace(
            shutter=np.outer(self._shutter_rad, self._shutter_rad))
        if self._measured is None or own is self._measured.covariance_sensor:
            return budget._replace(stars=own - self._common, exposure=self._common)
        motion = own - self._state.covariance[:3, :3]
        return budget._replace(
            stars=own - motion - self._common, motion=motion, exposure=self._common)

    @property
    def lens(self) -> Lens:
        return self._lens_error.lens

    @property
    def lens_error_px(self) -> float:
        return self._lens_error.value_px

    @property
    def lens_scale(self) -> float:
        return self._lens_error.scale_sigma

    @property
    def stamp_sigma_s(self) -> float:
        return self._stamp_jitter.sigma_s

    @property
    def stamp_turn_rad(self) -> np.ndarray:
        return self._stamp_jitter.turn_rad

    @property
    def predicted(self) -> TrackedAttitude:
        state = state_of(self._motion, SMOOTH)
        if self._motion.weight[SMOOTH].sum() < MOTION_ENDS.probability:
            # After a jump no smooth motion predicts the next frame.
            state = state._replace(quaternion=np.full(4, np.nan))
        return TrackedAttitude(
            AttitudeEstimate(state.quaternion, state.covariance[:3, :3], 0, np.empty(0), 0.0),
            state.rate, state.covariance[3:6, 3:6])

    @property
    def measured_attitude(self) -> AttitudeEstimate | None:
        return self._measured

    @property
    def rate_rad_s(self) -> np.ndarray:  # type: ignore[override]  # a property of the state
        return self._state.rate

    @property
    def rate_covariance(self) -> np.ndarray:  # type: ignore[override]  # the same
        return self._covariance[3:, 3:]

    @property
    def cross_covariance(self) -> np.ndarray:
        return self._covariance[:3, 3:]

    @property
    def acceleration(self) -> Acceleration:
        if not self._motion.interval_s:
            return Acceleration(*[np.zeros(3)] * 4)
        return Acceleration(*course(self._motion, self._acceleration_rad_s2))

    def _compare_gyro(self, before_ns: int, was_used: bool) -> None:
        """
        Use the gyro once it has agreed with the stars for confirm_frames; report if it does not.

        A wrong unit, axis or sign gives rates that would lose the stars.
        """
        state, gyro, measured = self._state, self._gyro, self._measured
        if self._is_saturated(state.stamp_ns):
            self._agreement.interrupt()
            self.gyro_trouble = GYRO_AT_RANGE.diagnostic
            return
        if gyro.silent_s(state.stamp_ns) > GYRO_SILENCE_S:
            self._agreement.interrupt()
            self.gyro_trouble = ''
            return
        if measured is None:
            return
        if was_used and not self.uses_gyro:
            self._agreement.contradict()
        elif self._agreement.add(
                state.stamp_ns, measured.quaternion,
                super().budget(measured.covariance_sensor, 0.0).covariance,
                state.drift, state.covariance[6:, 6:]):
            self._set_motion(self._motion, False)
        else:
            if not self.uses_gyro and self._agreement.is_enough(self._options.confirm_frames):
                self.uses_gyro, self.gyro_trouble = True, ''
            return
        self.gyro_trouble = GYRO_DIFFERS.diagnostic.format(
            reported=rate_text(gyro.mean_rate(before_ns, state.stamp_ns)[0]),
            stars=rate_text(self.rate_rad_s))


class _ErrorScale:
    """
    Ratio of the residuals to the sigma of the centroids: above 1 for a lens not calibrated.

    value is 1 where the ratio is not significant. It is below 1 only when the precise stars, which
    have the weight, have smaller residuals as well.
    """

    def __init__(self, scale: float) -> None:
        self._ratio = self._precise = self.value = scale
        self._frames = 1

    def restart(self) -> None:
        """Begin anew at the next frame: a better lens is known from now on."""
        self._frames = 0

    def add(self, typical: float, precise: float, is_floor: bool) -> None:
        """
        Add medians of the residuals of a good frame as of Correction, over sigma times value.

        is_floor is whether some sigma is the least one that is assumed, which stays as it is.
        """
        size = self.value / RAYLEIGH_MEDIAN
        self._frames = min(self._frames + 1, ERROR_SCALE.frames)
        self._ratio += (size * typical - self._ratio) / self._frames
        self._precise += ((1.0 if is_floor else size * precise) - self._precise) / self._frames
        largest = max(self._ratio, self._precise)
        self.value = 1.0
        if self._ratio > LARGE:
            self.value = self._ratio
        elif largest < SMALL and self._frames == ERROR_SCALE.frames:
            self.value = max(largest, LEAST)


def _with_turns(motion: Motion, error: np.ndarray) -> Motion:
    """Return a motion of whose modes the attitudes have another error (3, 3) rad^2."""
    if error is NO_ERROR:
        return motion
    covariance = motion.covariance.copy()
    covariance[:, :3, :3] += error
    return motion._replace(covariance=covariance)


def _unseen(jump: _Jump, share: float) -> np.ndarray:
    """
    Return the covariance (3, 3) of a jump at the very beginning or end of an exposure.

    Of a body that jumps in a share of the frames.
    """
    tail = tail_sigmas(share * UNSEEN, MISSED_LIGHT)
    size = UNSEEN * _across(jump.moved, jump.rate)
    sigma = size / (WRONG_SIGMAS - tail) if tail else 0.0
    return sigma ** 2 * np.eye(3)


def _across(moved: np.ndarray, rate: np.ndarray) -> float:
    """Return the size of a turn (3,) across a rate (3,): along it an error of time turns."""
    along = rate / max(float(np.linalg.norm(rate)), 1e-12)
    return float(np.linalg.norm(np.cross(moved, along)))


def _acceleration_of(motion: Motion) -> np.ndarray:
    acceleration: np.ndarray = motion.weight @ motion.mean[:, 6:9]
    return acceleration


def _inliers(correction: Correction) -> int:
    return int(np.count_nonzero(correction.inlier))


def _with_error(state: AttitudeState, error: np.ndarray) -> AttitudeState:
    """Return a state whose attitude has another error, of covariance (3, 3) rad^2."""
    if error is NO_ERROR:
        return state
    covariance = state.covariance.copy()
    covariance[:3, :3] += error
    return state._replace(covariance=covariance)
