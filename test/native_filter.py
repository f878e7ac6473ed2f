# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The filter of the native core for tests: its functions by ctypes, and a record of real runs.

test/native/filter.npz has what the filter was given and what it gave in runs of the integrity
campaign, from when it was written in Python.
"""

import ctypes
from pathlib import Path
from typing import NamedTuple

from native_core import kernels
import numpy as np

MODES = 9
STEADY, TORQUE, SWING, JUMP = 0, 1, 2, 3
KIND = np.array([STEADY, TORQUE, TORQUE, TORQUE, TORQUE, SWING, SWING, JUMP, JUMP])
SIZE = np.array([1.0, 0.02, 0.2, 2.0, 20.0, 0.1, 1.0, 100.0, 1000.0])
W2, CENTRE = 15, slice(17, 20)
RECORD = Path(__file__).parent / 'native' / 'filter.npz'

_REAL, _POINTER, _WHOLE = ctypes.c_double, ctypes.c_void_p, ctypes.c_int32


class State(NamedTuple):
    """Quaternion (4,), rate and drift (3,), covariance (9 + K, 9 + K) at a time."""

    stamp_ns: int
    quaternion: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    covariance: np.ndarray


class Motion(NamedTuple):
    """
    The motion at a time.

    quaternion (4,); of the modes mean (9, N), covariance (9, N, N), weight and share (9,);
    noise (3,), interval_s, frames, swing (20,);
    jumps (3,), squares over those of the noise, mean of seen_jumps.
    """

    stamp_ns: int
    quaternion: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    noise: np.ndarray
    interval_s: float
    frames: float
    swing: np.ndarray
    jumps: np.ndarray = np.ones(3)
    seen_jumps: float = 1.0


class _State(ctypes.Structure):
    _fields_ = [('stamp_ns', ctypes.c_int64), ('quaternion', _REAL * 4), ('rate', _REAL * 3),
                ('drift', _REAL * 3), ('covariance', _POINTER)]


class _Motion(ctypes.Structure):
    _fields_ = [('stamp_ns', ctypes.c_int64), ('constants', _WHOLE), ('wide', _WHOLE),
                ('quaternion', _REAL * 4), ('weight', _REAL * MODES), ('share', _REAL * MODES),
                ('noise', _REAL * 3), ('interval_s', _REAL), ('frames', _REAL),
                ('swing', _REAL * 20), ('jumps', _REAL * 3), ('seen_jumps', _REAL),
                ('mean', _POINTER), ('covariance', _POINTER)]


class _Gyro(ctypes.Structure):
    _fields_ = [('options', _POINTER), ('stamp_ns', _POINTER), ('rates', _POINTER),
                ('count', _WHOLE), ('capacity', _WHOLE)]


class _Correction(ctypes.Structure):
    _fields_ = [*((name, _WHOLE) for name in (
                    'agreed', 'count', 'stars', 'inliers', 'size', 'reserved')),
                *((name, _POINTER) for name in (
                    'star', 'best', 'inlier', 'unassociated', 'predicted', 'probability',
                    'distance_px', 'normalised')),
                ('state', _State), ('information', _REAL * 36), ('vector', _REAL * 6),
                ('by_acceleration', _REAL * 18), ('turn', _REAL * 3),
                ('turn_covariance', _REAL * 9), ('innovation', _REAL * 3),
                *((name, _REAL) for name in ('residual_px', 'chi2', 'typical', 'precise'))]


def _reals(array) -> np.ndarray:
    """Return a copy as an array of float64 that stays alive as long as its address is used."""
    return np.array(array, float, order='C')


def _into(target, array) -> None:
    target[:] = np.ravel(array).tolist()


# --- the state ---


class _NativeState:
    """A state as the kernels have it; the struct points into the arrays here."""

    def __init__(self, state: State) -> None:
        self.covariance = _reals(state.covariance)
        self.struct = _State(int(state.stamp_ns), covariance=self.covariance.ctypes.data)
        # An address refers to the struct alone, which needs the arrays.
        self.struct.owner = self
        for name in ('quaternion', 'rate', 'drift'):
            _into(getattr(self.struct, name), getattr(state, name))

    @property
    def address(self):
        return ctypes.byref(self.struct)

    @property
    def value(self) -> State:
        one = self.struct
        return State(one.stamp_ns, np.array(one.quaternion), np.array(one.rate),
                     np.array(one.drift), self.covariance.copy())


def empty_state(constants: int = 0) -> State:
    size = 9 + constants
    return State(0, np.zeros(4), np.zeros(3), np.zeros(3), np.zeros((size, size)))


def with_measured(state: State, information: np.ndarray, vector: np.ndarray) -> State:
    """Return the state after a measurement of its turn, (3, 3), or of turn and rate, (6, 6)."""
    native, Y, y = _NativeState(state), _reals(information), _reals(vector)
    kernels().stt_with_measured(native.address, len(y), Y.ctypes.data, y.ctypes.data)
    return native.value


def with_new_drift(state: State, sigma_rad_s: float) -> State:
    native = _NativeState(state)
    kernels().stt_with_new_drift(native.address, sigma_rad_s)
    return native.value


# --- the motion ---


class _NativeMotion:
    """A motion as the kernels have it; the struct points into the arrays here."""

    def __init__(self, motion: Motion, wide: bool) -> None:
        self.mean, self.covariance = _reals(motion.mean), _reals(motion.covariance)
        self.struct = _Motion(
            int(motion.stamp_ns), self.mean.shape[1] - 12, wide,
            interval_s=motion.interval_s, frames=motion.frames, seen_jumps=motion.seen_jumps,
            mean=self.mean.ctypes.data, covariance=self.covariance.ctypes.data)
        self.struct.owner = self
        for name in ('quaternion', 'weight', 'share', 'noise', 'swing', 'jumps'):
            _into(getattr(self.struct, name), getattr(motion, name))

    @property
    def address(self):
        return ctypes.byref(self.struct)

    @property
    def value(self) -> Motion:
        one = self.struct
        return Motion(one.stamp_ns, np.array(one.quaternion), self.mean.copy(),
                      self.covariance.copy(), np.array(one.weight), np.array(one.share),
                      np.array(one.noise), one.interval_s, one.frames, np.array(one.swing),
                      np.array(one.jumps), one.seen_jumps)


class Filter(NamedTuple):
    """The functions of the filter of a single tracker, or of that of several heads (wide)."""

    wide: bool = False

    def _changed(self, name: str, motion: Motion, *arguments) -> Motion:
        native = _NativeMotion(motion, self.wide)
        arrays = [_reals(one) if isinstance(one, np.ndarray) else one for one in arguments]
        getattr(kernels(), name)(native.address, *(
            one.ctypes.data if isinstance(one, np.ndarray) else one for one in arrays))
        return native.value

    def started(self, state: State, noise: np.ndarray, interval_s: float,
                constants: np.ndarray = np.empty(0)) -> Motion:
        size = 12 + len(constants)
        empty = Motion(0, np.zeros(4), np.zeros((MODES, size)), np.zeros((MODES, size, size)),
                       np.zeros(MODES), np.zeros(MODES), np.zeros(3), 0.0, 0.0, np.zeros(20))
        return self._changed('stt_start_motion', empty, _NativeState(state).address,
                             np.r_[constants, 0.0], noise, interval_s)

    def restarted(self, motion: Motion, state: State) -> Motion:
        return self._changed('stt_restart_motion', motion, _NativeState(state).address)

    def resumed(self, motion: Motion, known: Motion) -> Motion:
        return self._changed('stt_resume_motion', motion, _NativeMotion(known, self.wide).address)

    def interrupted(self, motion: Motion) -> Motion:
        return self._changed('stt_interrupt_motion', motion)

    def predicted(self, motion: Motion, to_ns: int, dt_s: np.ndarray, measured: np.ndarray,
                  variance: np.ndarray, acceleration: np.ndarray, walk: np.ndarray) -> Motion:
        assert len(walk) == motion.mean.shape[1] - 9 and len(dt_s) == len(variance) + 1
        return self._changed('stt_predict_motion', motion, int(to_ns), len(variance), dt_s,
                             measured, variance, acceleration, walk)

    def updated(self, motion: Motion, quaternion: np.ndarray, rate: np.ndarray,
                information: np.ndarray, vector: np.ndarray, beside: np.ndarray,
                moved: np.ndarray) -> Motion:
        whole = np.zeros((len(vector), motion.mean.shape[1] - 6))
        whole[:, :beside.shape[1]] = beside
        return self._changed('stt_update_motion', motion, quaternion, rate, len(vector),
                             information, vector, whole, moved)

    def with_measured(self, motion: Motion, before_ns: int, quaternion: np.ndarray,
                      R: np.ndarray) -> Motion:
        return self._changed('stt_measure_motion', motion, int(before_ns), quaternion, R)

    def state_of(self, motion: Motion, weight: np.ndarray | None = None) -> State:
        return self.state_and_constants(motion, weight)[0]

    def state_and_constants(self, motion: Motion, weight: np.ndarray | None = None
                            ) -> tuple[State, np.ndarray]:
        constants = np.zeros(motion.mean.shape[1] - 11)
        state = _NativeState(empty_state(len(constants) - 1))
        weights = _reals(motion.weight if weight is None else weight)
        kernels().stt_state_of(_NativeMotion(motion, self.wide).address, weights.ctypes.data,
                               state.address, constants.ctypes.data)
        return state.value, constants[:-1]

    def _found(self, name: str, motion: Motion, result: np.ndarray, *arguments) -> np.ndarray:
        arrays = [_reals(one) for one in arguments]
        getattr(kernels(), name)(_NativeMotion(motion, self.wide).address, *(
            one.ctypes.data for one in arrays), result.ctypes.data)
        return result

    def with_tails(self, motion: Motion, covariance: np.ndarray) -> np.ndarray:
        return self._found('stt_with_tails', motion, _reals(covariance))

    def acceleration_of(self, motion: Motion) -> np.ndarray:
        return self._found('stt_acceleration_of', motion, np.empty(3))


TRACKER, HEADS = Filter(), Filter(True)


def vibration_covariance(motion: Motion) -> np.ndarray:
    return TRACKER._found('stt_vibration_covariance', motion, np.empty((6, 6)))


def course_of(motion: Motion, acceleration: np.ndarray) -> np.ndarray:
    """Return acceleration, its sigma, jerk, and sigma before (4, 3)."""
    return TRACKER._found('stt_course_of', motion, np.empty((4, 3)), acceleration)


# --- gyro ---


class Gyro:
    """Rates (K, 3) of stamps (K,) as a gyro of options (4,) has them."""

    def __init__(self, options: np.ndarray, stamp_ns: np.ndarray, rates: np.ndarray,
                 capacity: int = 100_000) -> None:
        self._arrays = (_reals(options), np.array(stamp_ns, np.int64), _reals(rates))
        self.struct = _Gyro(*(one.ctypes.data for one in self._arrays), len(stamp_ns), capacity)

    def _call(self, name: str, *arguments):
        return getattr(kernels(), f'stt_gyro_{name}')(ctypes.byref(self.struct), *arguments)

    @property
    def model(self) -> np.ndarray:
        """Return drift sigma, drift density, noise density, change of the rate, range."""
        model = np.empty(5)
        self._call('model', model.ctypes.data)
        return model

    def __len__(self) -> int:
        return self._call('count')

    def silent_s(self, stamp_ns: int) -> float:
        return self._call('silent_s', int(stamp_ns))

    def is_saturated(self, stamp_ns: int, for_s: float) -> bool:
        return bool(self._call('is_saturated', int(stamp_ns), for_s))

    def propagate(self, state: State, to_ns: int) -> State:
        native = _NativeState(state)
        self._call('propagate', len(state.covariance) - 9, native.address, int(to_ns))
        return native.value

    def predict(self, state: State, to_ns: int) -> tuple[State, State]:
        native, predicted = _NativeState(state), _NativeState(empty_state())
        self._call('predict', native.address, int(to_ns), predicted.address)
        return native.value, predicted.value

    def rates(self, from_ns: int, to_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        dt_s, rates, variance = np.empty(5), np.empty((4, 3)), np.empty(4)
        count = self._call('rates', int(from_ns), int(to_ns), dt_s.ctypes.data,
                           rates.ctypes.data, variance.ctypes.data)
        return dt_s[:count + 1], rates[:count], variance[:count]

    def mean_rate(self, from_ns: int, to_ns: int) -> tuple[np.ndarray, float]:
        found = np.empty(4)
        self._call('mean_rate', int(from_ns), int(to_ns), found.ctypes.data)
        return found[:3], found[3]


# --- stars ---

CAMERA = np.dtype([('size', np.int32, 2), ('focal', float, 2), ('centre', float, 2),
                   ('distortion', float, 8), ('model', np.int32), ('reserved', np.int32)])


def camera_of(numbers: np.ndarray) -> np.ndarray:
    """Return st_camera of width, height, fx, fy, cx, cy, eight terms, model (15,)."""
    camera = np.zeros((), CAMERA)
    camera['size'], camera['focal'], camera['centre'] = numbers[:2], numbers[2:4], numbers[4:6]
    camera['distortion'], camera['model'] = numbers[6:14], numbers[14]
    return camera


class Correction(NamedTuple):
    """A corrected attitude, as Correction of correction.h; the lists are of K stars."""

    agreed: bool
    star: np.ndarray
    best: np.ndarray
    inlier: np.ndarray
    unassociated: np.ndarray
    predicted: np.ndarray
    probability: np.ndarray
    distance_px: np.ndarray
    normalised: np.ndarray
    state: State
    information: np.ndarray
    vector: np.ndarray
    by_acceleration: np.ndarray
    turn: np.ndarray
    turn_covariance: np.ndarray
    innovation: np.ndarray
    stars: int
    figures: np.ndarray  # residual_px, chi2, typical, precise


def correct(camera: np.ndarray, icrf: np.ndarray, usable: np.ndarray, min_stars: int,
            predicted: State, centroid: np.ndarray, detection: np.ndarray,
            outlier_sigmas: float = 5.0) -> Correction:
    """Correct an attitude by centroid (M, 6): u, v, uu, uv, vv, delay."""
    stars, centroids = len(icrf), len(centroid)
    whole = {name: np.zeros(most, np.int32) for name, most in (
        ('star', stars), ('best', stars), ('inlier', stars), ('unassociated', centroids))}
    real = {'predicted': np.zeros((stars, 2)), 'probability': np.zeros((stars, centroids + 1)),
            'distance_px': np.zeros(stars), 'normalised': np.zeros(stars)}
    state = _NativeState(empty_state())
    found = _Correction(state=state.struct, **{
        name: one.ctypes.data for name, one in {**whole, **real}.items()})
    directions, places, model = _reals(icrf), _reals(centroid), _reals(detection)
    may_correct = np.array(usable, np.int32)
    kernels().stt_correct(
        camera.ctypes.data, directions.ctypes.data, may_correct.ctypes.data, stars, min_stars,
        outlier_sigmas, _NativeState(predicted).address, places.ctypes.data, centroids,
        model.ctypes.data, ctypes.byref(found))
    count, size = found.count, found.size
    state.struct = found.state
    columns = centroids + 1
    return Correction(
        bool(found.agreed), whole['star'][:count], whole['best'][:count],
        whole['inlier'][:count] != 0, whole['unassociated'] != 0, real['predicted'][:count],
        real['probability'].ravel()[:count * columns].reshape(count, columns),
        real['distance_px'][:count], real['normalised'][:count], state.value,
        np.array(found.information).reshape(6, 6)[:size, :size], np.array(found.vector)[:size],
        np.array(found.by_acceleration).reshape(6, 3)[:size], np.array(found.turn),
        np.array(found.turn_covariance).reshape(3, 3), np.array(found.innovation), found.stars,
        np.array([found.residual_px, found.chi2, found.typical, found.precise]))


def on_image(camera: np.ndarray, icrf: np.ndarray, state: State
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return state (N, 4) and covariance (N, 4, 4) of directions (N, 3) in the image."""
    directions, count = _reals(icrf), len(icrf)
    states, covariances = np.empty((count, 4)), np.empty((count, 4, 4))
    kernels().stt_on_image(camera.ctypes.data, directions.ctypes.data, count,
                           _NativeState(state).address, states.ctypes.data,
                           covariances.ctypes.data)
    return states, covariances


def at_frame_time(camera: np.ndarray, uv: np.ndarray, delay_s: np.ndarray, rate: np.ndarray,
                  acceleration: np.ndarray) -> np.ndarray:
    arrays = [_reals(one) for one in (uv, delay_s, rate, acceleration)]
    moved = np.empty_like(arrays[0])
    kernels().stt_at_frame_time(
        camera.ctypes.data, *(one.ctypes.data for one in arrays[:2]), len(delay_s),
        *(one.ctypes.data for one in arrays[2:]), moved.ctypes.data)
    return moved


def fit_rate(camera: np.ndarray, icrf: np.ndarray, uv: np.ndarray, sigma_px: np.ndarray,
             delay_s: np.ndarray, quaternion: np.ndarray) -> np.ndarray | None:
    arrays, rate = [_reals(one) for one in (icrf, uv, sigma_px, delay_s)], np.empty(3)
    attitude = _reals(quaternion)
    if not kernels().stt_fit_rate(camera.ctypes.data, *(one.ctypes.data for one in arrays),
                                  len(delay_s), attitude.ctypes.data, rate.ctypes.data):
        return None
    return rate


# --- small functions ---


def by_experience(weight: np.ndarray, share: np.ndarray) -> np.ndarray:
    arrays, seen = [_reals(one) for one in (weight, share)], np.empty(MODES)
    kernels().stt_by_experience(*(one.ctypes.data for one in arrays), seen.ctypes.data)
    return seen


def tail_sigmas(probability: float, missed: float) -> float:
    return kernels().stt_tail_sigmas(probability, missed)


def covariance_deficit(covariance: np.ndarray, error: np.ndarray, across: float,
                       probability: float) -> np.ndarray:
    arrays, deficit = [_reals(one) for one in (covariance, error)], np.empty((3, 3))
    kernels().stt_covariance_deficit(*(one.ctypes.data for one in arrays), across, probability,
                                     deficit.ctypes.data)
    return deficit
