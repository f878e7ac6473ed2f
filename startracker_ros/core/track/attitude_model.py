# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One rotation moves all stars: one filter of attitude and rate, updated by all of them."""

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState, NIS_GATE, Prediction
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.attitude.gyro import AT_ITS_RANGE, Gyro, rate_text
from startracker_ros.core.attitude.result import pointing_covariance
from startracker_ros.core.camera.lens import Lens
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids, UNKNOWN_EXPOSURE
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.small_algebra import is_positive_definite
from startracker_ros.core.track.acceleration import AngularAcceleration, lacking, STEADY
from startracker_ros.core.track.consistency import Residuals
from startracker_ros.core.track.correction import correct, Correction
from startracker_ros.core.track.followed_stars import followed, Measured
from startracker_ros.core.track.gyro_agreement import GyroAgreement
from startracker_ros.core.track.lens_error import LensError
from startracker_ros.core.track.model import FrameUpdate, StarModel
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.process_noise import ProcessNoise
from startracker_ros.core.track.rate_jumps import HiddenJumps, Mixture, NO_JUMP, RateJumps
from startracker_ros.core.track.rolling_shutter import at_frame_time
from startracker_ros.core.track.rotation_fit import is_good, RAYLEIGH_MEDIAN, RotationFit
from startracker_ros.core.track.stamp_jitter import measured_turn, StampJitter
from startracker_ros.core.track.start import Start
from startracker_ros.core.track.tracks import Acceleration

MANOEUVRE_HYPOTHESES = (10.0, 100.0, 1000.0)
"""Accelerations tried one after the other, in units of acceleration_deg_s2, when the innovation
of a frame is too large: so one option filters a steady turn and follows a manoeuvre. The
covariance is inflated by the same factor, as a manoeuvre is detected frames after its begin."""

LIKELY = gate(0.05, 3)
"""Chi-square of three axes that one frame in twenty exceeds, by which a manoeuvre is as large as
the innovation: the least one within the gate would leave up to NIS_GATE, and a rate that is wrong
by as much."""

RATE_DOUBT_FRAMES = 3
"""From a change of the rate on, until the new acceleration is known."""

DIVERGED_SIGMAS, DIVERGED_FRAMES = 20.0, 5
"""Innovation by stars that agree, in so many frames in a row, of a filter that has diverged."""

SHEARED = 3
"""Stars of a rolling shutter that are not where a hypothesis has them, from which on they may have
been exposed after a jump of the rate: another one is tried, and taken if it has as many more."""

SCALE_FRAMES = 20
LARGE, SMALL, LEAST = 1.15, 0.9, 0.5
"""In which the errors of centroids are compared with their residuals, and ratios that differ from
1; errors are taken for no less than half of what the centroids have."""

GYRO_SILENCE_S = 1.0
"""Age of the newest gyro rate from which on the rate is that of the stars alone."""


_NO_ERROR = np.zeros((3, 3))
_NOTHING = Measured(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), np.empty(0),
                    np.empty((0, 2, 2)))
"""The centroids of a frame that is not used."""


class _Rows(NamedTuple):
    """
    half_s2 is half the mean square of the delays of a rolling shutter, zero without one.

    acceleration (3,) rad/s^2 is that by which the centroids are moved to the time of the frame.
    """

    half_s2: float
    acceleration: np.ndarray


class _Hypothesis(NamedTuple):
    """
    A predicted state, by a gyro or not.

    prediction is that of the process noise alone, None of a manoeuvre and of a gyro alone. The
    innovation of the frame is to be within a gate.
    """

    uses_gyro: bool
    state: AttitudeState
    prediction: Prediction | None = None
    gate: float = NIS_GATE


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
        self._acceleration, self._exposure_s = AngularAcceleration(), UNKNOWN_EXPOSURE
        if start.cross.any():
            self._acceleration.start(frame.stamp_ns, frame.attitude.quaternion, start.rate)
        self._measured: AttitudeEstimate | None = None
        self._jumps, self._mixture = RateJumps(), NO_JUMP
        self._rate_doubt, self._changed_frames = _NO_ERROR, RATE_DOUBT_FRAMES
        self._hidden_jumps, self._process_noise = HiddenJumps(), ProcessNoise()
        self._moved, self._streaked = np.zeros(3), False
        self._rows = _Rows(0.0, np.zeros(3))

    def update(self, stamp_ns: int, frame: Centroids, sky: ApparentCatalog) -> FrameUpdate:
        """Update by the first hypothesis that the stars confirm, or keep the nominal one."""
        sparse = self.is_sparse(frame)
        icrf = sky.direction(self.bank.star_index)
        variance = (self._scale.value * self.sigma_px(frame)) ** 2
        error_px2 = self.error_px2(frame)
        common = (pointing_covariance(frame.correlated_error, self._camera, self._state.rate)
                  if frame.common.any() else _NO_ERROR)
        self._rows = _Rows(float(np.mean(frame.delay_s ** 2)) / 2 if len(frame) else 0.0,
                           self._acceleration.estimate.mean)
        nominal, confirmed = self._explained(
            stamp_ns, frame, icrf, self._scale.value ** 2 * error_px2, common)
        if confirmed is not None:
            hypothesis, correction = confirmed
            predicted = _with_error(hypothesis.state, common)
            before_ns, was_used = self._state.stamp_ns, self.uses_gyro
            self._exposure_s, self._streaked = frame.exposure_s, frame.are_streaks
            mixture = self._measure(hypothesis, predicted, correction, common,
                                    None if nominal is None else nominal[0].state)
            # The stars show the pointing up to the error that they share.
            corrected = _with_error(correction.state, common)
            state = _with_jumps(corrected, mixture)
            fit = self._fit(correction, state)
            if mixture.is_certain:
                corrected, mixture = state, NO_JUMP
            self._mixture = mixture
            self._moved = (rotation_between(predicted.quaternion, state.quaternion)
                           - self._hidden_jumps.expected)
            self._stamp_jitter.add(self._state, predicted, corrected, correction.measured,
                                   self._acceleration.white_rad2)
            self._set_state(corrected, hypothesis.uses_gyro)
            frame = self._at_frame_time(frame, corrected)
            seen, residuals = self._follow(correction, icrf, Measured(
                frame.uv, frame.flux, frame.snr, frame.sigma_px, variance, error_px2))
            least_px = self._scale.value * frame.sigma_px.min()
            self._scale.add(correction.typical, correction.precise,
                            least_px <= self._options.sigma_floor_px)
            if self._lens_error.add(seen, residuals):
                self._scale.restart()
            self._diverged = 0
            self._check_covariance()
            self._compare_gyro(before_ns, was_used)
            return FrameUpdate(True, fit, frame, correction.unassociated, residuals)
        assert nominal is not None, 'there is always a hypothesis'
        # Propagate without an update: every star counts as missed.
        hypothesis, correction = nominal
        self._stamp_jitter.interrupt()
        self._acceleration.interrupt()
        self._mixture = self._jumps.interrupt()
        self._rate_doubt = _NO_ERROR
        self._hidden_jumps.interrupt()
        self._process_noise.interrupt()
        self._set_state(hypothesis.state, hypothesis.uses_gyro)
        count = len(correction.predicted)
        self._follow(correction._replace(probability=np.ones((count, 1)),
                                         distance=np.full(count, np.inf)), icrf, _NOTHING)
        beyond = float(np.linalg.norm(correction.innovation))
        self._diverged = self._diverged + 1 if beyond > DIVERGED_SIGMAS else 0
        if self._diverged >= DIVERGED_FRAMES:
            self.failure = (f'the filter has diverged: {self._diverged} frames in a row with '
                            f'innovations beyond {DIVERGED_SIGMAS:g} sigma, the last of '
                            f'{beyond:.0f}')
        if sparse and hypothesis.uses_gyro and self._is_saturated(stamp_ns):
            self.failure = ('imu reaches gyro_range_deg_s while there are no stars: the attitude '
                            'is not known')
        self._check_covariance()
        return FrameUpdate(False, None, self._at_frame_time(frame, hypothesis.state),
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
            predicted = _with_error(hypothesis.state, common)
            correction = correct(
                self.lens, icrf, self.bank.confirmed, self._options.min_stars, predicted,
                np.ascontiguousarray(self._at_frame_time(frame, predicted).uv), error,
                frame.delay_s, self._detection)
            explanation = hypothesis, correction
            if not self._is_consistent(correction, hypothesis.gate):
                nominal = nominal or explanation
                if sparse:
                    break
                continue
            if confirmed is not None and _inliers(correction) < _inliers(confirmed[1]) + SHEARED:
                continue
            nominal, confirmed = nominal or confirmed, explanation
            if not self._rows.half_s2 or correction.stars - _inliers(correction) < SHEARED:
                break
        return nominal, confirmed

    def _at_frame_time(self, frame: Centroids, state: AttitudeState) -> Centroids:
        """Return the centroids at the time of the frame, of a body with the rate of a state."""
        return at_frame_time(self._camera, frame, state.rate, self._rows.acceleration)

    def _check_covariance(self) -> None:
        """Set the failure of a state whose covariance is none."""
        covariance = self._state.covariance
        variances = np.diagonal(covariance).tolist()
        if not (math.isfinite(covariance.sum()) and min(variances) > 0
                and is_positive_definite(covariance)):
            self.failure = ('the covariance of the filter is not positive definite, its diagonal '
                            f'is {variances}')

    def _is_saturated(self, stamp_ns: int) -> bool:
        """Return whether the gyro reached its range within GYRO_SILENCE_S before a time."""
        return self._gyro.is_saturated(stamp_ns, GYRO_SILENCE_S)

    def _hypotheses(self, stamp_ns: int, sparse: bool) -> Iterator[_Hypothesis]:
        """Yield the nominal prediction, then those of manoeuvres."""
        state, gyro = self._state, self._gyro
        density = self._acceleration_rad_s2 ** 2 * (stamp_ns - state.stamp_ns) * 1e-9
        with_gyro = self.uses_gyro and gyro.silent_s(stamp_ns) <= GYRO_SILENCE_S and (
            sparse or not self._is_saturated(stamp_ns))
        if with_gyro:
            # In a sparse frame no assumption about the acceleration holds.
            shown = self._acceleration.estimate
            if not sparse and gyro.expects(state, stamp_ns, shown.mean, shown.process):
                nominal = gyro.filtered(state, stamp_ns, shown.mean, density + shown.process * (
                    (stamp_ns - state.stamp_ns) * 1e-9))
                yield _Hypothesis(True, nominal.state, nominal)
            yield _Hypothesis(True, gyro.propagate(state, stamp_ns))
        else:
            nominal = self._propagated(state, stamp_ns, density)
            yield _Hypothesis(False, nominal.state, nominal)
        for factor in MANOEUVRE_HYPOTHESES:
            yield _Hypothesis(
                False,
                self._propagated(state.inflated(factor), stamp_ns, factor ** 2 * density).state,
                gate=NIS_GATE if factor == MANOEUVRE_HYPOTHESES[-1] else LIKELY)

    def _propagated(self, state: AttitudeState, stamp_ns: int, density: np.ndarray
                    ) -> Prediction:
        """Predict the state at a time, at the acceleration that the frames before have shown."""
        dt_s = (stamp_ns - state.stamp_ns) * 1e-9
        acceleration = self._acceleration.estimate
        turning = state._replace(rate=state.rate + acceleration.ahead * (dt_s / 2))
        after = turning.predicted_at_constant_rate(
            stamp_ns, density + acceleration.process * dt_s, self._gyro.drift_density)
        return after._replace(state=after.state._replace(
            rate=state.rate + acceleration.mean * dt_s))

    def _is_consistent(self, correction: Correction, gate: float) -> bool:
        """Return whether the fit of the inliers is good and its innovation within the gate."""
        return (correction.agreed
                and bool(correction.innovation @ correction.innovation <= gate)
                and is_good(_inliers(correction), correction.stars,
                            correction.residual_px, self._options.min_stars,
                            self._options.max_residual_px))

    def _fit(self, correction: Correction, state: AttitudeState) -> RotationFit:
        """Return the fit of the inliers, which gave a state."""
        inlier = correction.inlier
        attitude = AttitudeEstimate(
            state.quaternion, state.covariance[:3, :3] + self._process_noise.excess[:3, :3],
            int(np.count_nonzero(inlier)),
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

    def _set_state(self, state: AttitudeState, uses_gyro: bool) -> None:
        """Set the state; where the use of the gyro ends its drift becomes unknown."""
        if self.uses_gyro and not uses_gyro:
            state = state.with_new_drift(self._gyro.drift_sigma_rad_s)
            self._process_noise.interrupt()
        self._state, self.uses_gyro = state, uses_gyro

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
    def predicted_attitude(self) -> AttitudeEstimate:
        return AttitudeEstimate(self._state.quaternion, self._state.covariance[:3, :3], 0,
                                np.empty(0), 0.0)

    @property
    def measured_attitude(self) -> AttitudeEstimate | None:
        return self._measured

    def with_systematic_errors(self, estimate: AttitudeEstimate, velocity_sigma_m_s: float
                               ) -> AttitudeEstimate:
        """Return also what the acceleration within the exposure turns the stars by, taken out."""
        turn, covariance, share = self._acceleration.shift(
            self._exposure_s, self._state.rate, self._camera.fx if self._streaked else 0.0,
            *self._rows)
        # The acceleration is a measurement by the same stars.
        covariance -= 2 * share * estimate.covariance_sensor
        estimate = super().with_systematic_errors(estimate, velocity_sigma_m_s)
        covariance += estimate.covariance_sensor
        # A jump moves the light, or ends the acceleration that is taken out. Of one before the
        # frame the filter has followed a part.
        hidden = self._hidden_jumps
        probability = self._acceleration.jump_within(
            self._exposure_s[1] + math.sqrt(24 * self._rows.half_s2), hidden.probability)
        taken_out = turn + self._rows.half_s2 * self._rows.acceleration
        for error, chance in ((self._moved, probability), (taken_out, probability),
                              (hidden.unexpected - self._moved, hidden.probability)):
            covariance += lacking(covariance, error, chance)
        for axis in range(3):
            covariance[axis, axis] = max(covariance[axis, axis], self._mixture.least[axis] ** 2)
        return replace(estimate, quaternion=turned(estimate.quaternion, -turn),
                       covariance_sensor=covariance)

    def _measure(self, hypothesis: _Hypothesis, predicted: AttitudeState,
                 correction: Correction, common: np.ndarray,
                 contradicted: AttitudeState | None) -> Mixture:
        """
        Set the attitude that the stars of the frame measure, beside what was predicted.

        Return the errors by jumps of the rate.
        """
        adds, turn, covariance = measured_turn(predicted, correction.measured)
        if not adds:
            self._measured = None
            self._acceleration.interrupt()
            self._hidden_jumps.interrupt()
            self._process_noise.interrupt()
            self._rate_doubt = _NO_ERROR
            return self._jumps.interrupt()
        self._measured = AttitudeEstimate(
            turned(predicted.quaternion, turn), covariance + common, 0, np.empty(0), 0.0)
        # A gyro corrects the rate before the next frame, and what it measures alone is no jump.
        mixture = self._jumps.interrupt() if hypothesis.uses_gyro else NO_JUMP
        if hypothesis.prediction is not None:
            mixture = self._jumps.add(self._state.stamp_ns, predicted, turn, covariance)
        elif contradicted is not None and not hypothesis.uses_gyro:
            turn = rotation_between(contradicted.quaternion, self._measured.quaternion)
            mixture = self._jumps.found(counts=self._acceleration.is_known)
        is_steady = self._acceleration.estimate.way == STEADY
        self._acceleration.add(
            predicted.stamp_ns, self._measured.quaternion, self._measured.covariance_sensor,
            turn, mixture.newest)
        self._doubt_rate(hypothesis, mixture)
        if hypothesis.prediction is None or mixture.is_certain:
            self._process_noise.interrupt()
        else:
            self._process_noise.add(hypothesis.prediction, predicted.covariance,
                                    correction.state.covariance, turn, covariance)
        if (hypothesis.prediction is None or hypothesis.uses_gyro or mixture.is_certain
                or not is_steady or common is not _NO_ERROR):
            self._hidden_jumps.interrupt()
        else:
            self._hidden_jumps.add(hypothesis.prediction, turn, covariance,
                                   self._process_noise.ratio, self._jumps.share)
        return mixture

    def _doubt_rate(self, hypothesis: _Hypothesis, mixture: Mixture) -> None:
        """
        Set by what the rate may still change after a frame that contradicts its prediction.

        It shows the mean rate since the one before, or an attitude that was off. At the frame the
        rate may be another one by as much as the mean has changed, in the next ones by half of
        what it changes still.
        """
        self._changed_frames += 1
        if hypothesis.prediction is None or mixture.is_certain:
            self._changed_frames = 0
        if self._changed_frames >= RATE_DOUBT_FRAMES:
            self._rate_doubt = _NO_ERROR
            return
        share = 0.25
        if not self._changed_frames:
            # A gyro has measured the rate at the frame itself.
            share = 0.0 if hypothesis.uses_gyro else 1.0
        change = self._acceleration.rate_change
        self._rate_doubt = share * change[:, None] * change + self._rate_doubt / 4

    @property
    def rate_rad_s(self) -> np.ndarray:  # type: ignore[override]  # a property of the state
        return self._state.rate + self._mixture.mean[3:]

    @property
    def rate_covariance(self) -> np.ndarray:  # type: ignore[override]  # the same
        return (self._state.covariance[3:6, 3:6] + self._mixture.covariance[3:, 3:]
                + self._process_noise.excess[3:, 3:] + self._rate_doubt)

    @property
    def acceleration(self) -> Acceleration:
        estimate = self._acceleration.estimate
        # That of a steady turn is no more uncertain than its process noise says.
        variance = estimate.process if estimate.way == STEADY else estimate.variance
        return Acceleration(
            estimate.value, np.sqrt(variance + self._acceleration_rad_s2 ** 2),
            self._acceleration.lasts_s)

    @property
    def cross_covariance(self) -> np.ndarray:
        return (self._state.covariance[:3, 3:6] + self._mixture.covariance[:3, 3:]
                + self._process_noise.excess[:3, 3:])

    def _compare_gyro(self, before_ns: int, was_used: bool) -> None:
        """
        Use the gyro once it has agreed with the stars for confirm_frames; report if it does not.

        A wrong unit, axis or sign gives rates that would lose the stars.
        """
        state, gyro, measured = self._state, self._gyro, self._measured
        if self._is_saturated(state.stamp_ns):
            self._agreement.interrupt()
            self.gyro_trouble = AT_ITS_RANGE
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
                super().with_systematic_errors(measured, 0.0).covariance_sensor,
                state.drift, state.covariance[6:, 6:]):
            self._set_state(state, False)
        else:
            if not self.uses_gyro and self._agreement.is_enough(self._options.confirm_frames):
                self.uses_gyro, self.gyro_trouble = True, ''
            return
        reported = rate_text(gyro.mean_rate(before_ns, state.stamp_ns)[0])
        self.gyro_trouble = (
            f'imu reports {reported} deg/s about x, y, z, the stars '
            f'{rate_text(self.rate_rad_s)}: is it in rad/s, on the axes of the sensor, and '
            'gyro_drift_deg_h right?')


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
        self._frames = min(self._frames + 1, SCALE_FRAMES)
        self._ratio += (size * typical - self._ratio) / self._frames
        self._precise += ((1.0 if is_floor else size * precise) - self._precise) / self._frames
        largest = max(self._ratio, self._precise)
        self.value = 1.0
        if self._ratio > LARGE:
            self.value = self._ratio
        elif largest < SMALL and self._frames == SCALE_FRAMES:
            self.value = max(largest, LEAST)


def _inliers(correction: Correction) -> int:
    return int(np.count_nonzero(correction.inlier))


def _with_error(state: AttitudeState, error: np.ndarray) -> AttitudeState:
    """Return a state whose attitude has another error, of covariance (3, 3) rad^2."""
    if error is _NO_ERROR:
        return state
    covariance = state.covariance.copy()
    covariance[:3, :3] += error
    return state._replace(covariance=covariance)


def _with_jumps(state: AttitudeState, mixture: Mixture) -> AttitudeState:
    """Return a state with the errors by jumps."""
    covariance = state.covariance.copy()
    covariance[:6, :6] += mixture.covariance
    return state._replace(quaternion=turned(state.quaternion, mixture.mean[:3]),
                          rate=state.rate + mixture.mean[3:], covariance=covariance)
