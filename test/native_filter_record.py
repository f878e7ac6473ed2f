# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Write test/native/filter.npz: what the filter in Python is given in real runs, and what it gives.

Arrays of an archive are '<function> <name>', one call after the other, flat, with their shapes in
'<function> <name> shape' where these differ. Motions are numbers into 'mean' and 'covariance', of
which the lower triangle is stored.
"""

from collections import defaultdict
from contextlib import ExitStack
from unittest.mock import patch

from native_filter import RECORD
import numpy as np
from startracker_evaluation.campaign.integrity import CONDITIONS, IMAGE_CONDITIONS, run_of
from startracker_evaluation.campaign.integrity_motion import MOTION_CONDITIONS, motion_frames
from startracker_ros.core.attitude.gyro import Gyro
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.track import attitude_model, motion_filter
from startracker_ros.core.track.attitude_model import AttitudeModel
from startracker_ros.core.track.correction import on_image
from startracker_ros.core.track.rolling_shutter import at_one_time, fit_rate
from startracker_ros.tools.datasheet.image_runs import image_frames

SEED = 10
RUNS = {  # frames of each that are recorded
    'slews to 3 deg/s, gyro': (9, 30, 31), 'dark for 2 s at 0.3 deg/s, gyro': (20, 60),
    'list, steps of 0.5 deg/s each second': (9, 10, 11, 24),
    'list, sway 0.05 deg, 1 s, exposed 0.1 s': (30, 31),
    'list, ramps of 0.5 deg/s^2, 4 s, rolling shutter': (12, 13),
    'list, sway 0.2 deg, 2 s, exposed 0.1 s': (18,),
    'list, torques of 0.2 deg/s^2, 2 s, exposed 0.1 s': (20, 21),
    'list, steps of 0.05 deg/s each 3 s, rolling shutter': (29, 30),
    'smear 5 deg/s, 20 ms': (8,), 'rolling shutter 1 deg/s': (8, 9), 'kicks of 40 arcsec': (8, 9),
    'vibration 100 arcsec': (30,), 'debris, 150 of 3 px': (10,)}


class Record:
    """The calls of functions, while is_on."""

    def __init__(self) -> None:
        self.is_on = False
        self._arrays: dict[str, list[np.ndarray]] = defaultdict(list)
        self._motions: dict[bytes, int] = {}

    def add(self, function: str, **named) -> None:
        for name, value in named.items():
            if isinstance(value, motion_filter.Motion):
                self._add_motion(f'{function} {name}', value)
            elif hasattr(value, '_fields'):
                for part, one in zip(value._fields, value):
                    self._add(f'{function} {name}.{part}', one)
            else:
                self._add(f'{function} {name}', value)

    def _add(self, key: str, value) -> None:
        array = np.array(value)
        self._arrays[key].append(array.astype(np.int64 if array.dtype.kind in 'biu' else float))

    def _add_motion(self, key: str, motion) -> None:
        modes = motion.mean.tobytes() + motion.covariance.tobytes()
        if modes not in self._motions:
            self._motions[modes] = len(self._motions)
            n = motion.mean.shape[1]
            self._add('mean', motion.mean)
            self._add('covariance', motion.covariance[:, *np.tril_indices(n)])
        self._add(f'{key} modes', self._motions[modes])
        rest = motion._replace(mean=None, covariance=None)
        self._add(f'{key} numbers', np.concatenate([
            np.ravel(one) for one in rest[1:] if one is not None]))
        self._add(f'{key} stamp_ns', motion.stamp_ns)

    def save(self, path) -> None:
        saved = {}
        for key, arrays in self._arrays.items():
            saved[key] = np.concatenate([np.ravel(one) for one in arrays])
            if arrays[0].ndim:
                shapes = np.array([one.shape for one in arrays], np.int32)
                saved[f'{key} shape'] = shapes[:1] if (shapes == shapes[0]).all() else shapes
        np.savez_compressed(path, **saved)


def recorded(record: Record, name: str, function, arguments: tuple[str, ...]):
    """Return a function that records its calls."""
    def call(*given):
        found = function(*given)
        if record.is_on:
            record.add(name, **dict(zip(arguments, given)), result=found)
        return found
    return call


def recorded_correct(record: Record):
    def call(lens, icrf, usable, min_stars, predicted, uv, error, delay_s, detection):
        found = original(lens, icrf, usable, min_stars, predicted, uv, error, delay_s, detection)
        if record.is_on:
            beta = found.probability
            row, column = np.nonzero(beta)
            record.add(
                'correct', camera=camera_of(lens), icrf=icrf, usable=usable, min_stars=min_stars,
                predicted=predicted, uv=uv, error=error, delay_s=delay_s,
                detection=np.array(detection), **{
                    name: getattr(found, name) for name in found._fields
                    if name not in ('probability', 'predicted')}, at=found.predicted,
                beta_row=row, beta_column=column, beta=beta[row, column])
            few = np.ascontiguousarray(icrf[found.inside][:5])
            states, covariances = on_image(lens, few, found.state)
            record.add('on_image', camera=camera_of(lens), icrf=few, state=found.state,
                       states=states, covariances=covariances)
            if delay_s.any():
                acceleration = np.array([1e-3, -2e-3, 3e-4])
                record.add('late', camera=camera_of(lens), uv=uv, delay_s=delay_s,
                           rate=predicted.rate, acceleration=acceleration, result=at_one_time(
                               lens, uv, delay_s, predicted.rate, acceleration))
                record_fit(record, lens, icrf[found.inside][found.inlier],
                           uv[found.best[found.inlier]], error[found.best[found.inlier]],
                           delay_s[found.best[found.inlier]], predicted)
        return found
    original = attitude_model.correct
    return call


def record_fit(record: Record, lens, icrf, uv, error, delay_s, state) -> None:
    """Record the rate that stars show which are not yet brought to one time."""
    late = 2 * uv - at_one_time(lens, uv, delay_s, state.rate, np.zeros(3))
    centroids = Centroids(late, *np.ones((2, len(late))), sigma_px=np.sqrt(error[:, 0, 0]),
                          delay_s=delay_s)
    camera = Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
    record.add('fit_rate', camera=camera_of(lens), icrf=icrf, uv=late, delay_s=delay_s,
               sigma_px=centroids.sigma_px, quaternion=state.quaternion,
               result=fit_rate(camera, icrf, centroids, state.quaternion))


def camera_of(lens):
    terms = lens.terms
    named = ([terms.k1, terms.k2, terms.p1, terms.p2, terms.k3, terms.k4, terms.d1, terms.d2,
              terms.d3] if hasattr(terms, 'k1') else list(terms))
    assert not any(named[5:]), 'plumb_bob'
    return np.array([lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, *named[:5],
                     0, 0, 0, 0])


def frames_of(name):
    rng = np.random.default_rng(SEED)
    if name in CONDITIONS:
        yield from run_of(CONDITIONS[name], rng)
    elif name in MOTION_CONDITIONS:
        yield from motion_frames(MOTION_CONDITIONS[name], rng, 40)
    else:
        yield from image_frames(IMAGE_CONDITIONS[name], SEED)


def record_run(record: Record, name: str, frames: tuple[int, ...]) -> None:
    count, update, gyros = 0, AttitudeModel.update, []

    def counted(model, *given):
        nonlocal count
        record.is_on = count in frames
        count += 1
        found = update(model, *given)
        if record.is_on and found.good:
            motion, acceleration = model._motion, model._acceleration_rad_s2
            state = motion_filter.state_of(motion)
            wide = motion_filter.state_of(motion, np.array([3, 8]))
            record.add(
                'published', motion=motion, acceleration=acceleration, state=state, wide=wide,
                tails=motion_filter.with_tails(motion, state.covariance[:6, :6].copy()),
                vibration=motion_filter.of_vibration(motion),
                experience=motion_filter.by_experience(motion.weight, motion.share),
                course=np.array(motion_filter.course(motion, acceleration)),
                mean_acceleration=motion.weight @ motion.mean[:, 6:9])
        if record.is_on and model._gyro._rates:
            gyros.append((model._gyro, model._state))
        record.is_on = False
        return found

    motions = {'predicted': ('motion', 'to_ns', 'dt_s', 'measured', 'variance', 'acceleration',
                             'walk'),
               'updated': ('motion', 'quaternion', 'rate', 'information', 'vector', 'beside',
                           'moved'),
               'with_measured': ('motion', 'before_ns', 'quaternion', 'R'),
               'restarted': ('motion', 'state'), 'interrupted': ('motion',),
               'lacking': ('covariance', 'error', 'across', 'probability')}
    with ExitStack() as stack:
        stack.enter_context(patch.object(AttitudeModel, 'update', counted))
        stack.enter_context(patch.object(attitude_model, 'correct', recorded_correct(record)))
        for function, arguments in motions.items():
            stack.enter_context(patch.object(attitude_model, function, recorded(
                record, function, getattr(attitude_model, function), arguments)))
        for _ in frames_of(name):
            if count > max(frames):
                break
    print(name, count, len(gyros))
    if gyros:
        record_gyro(record, *gyros[-1])


def record_gyro(record: Record, gyro: Gyro, state) -> None:
    """Record what a gyro of a run says between many times."""
    stamps, rates = gyro._stamps_ns[-120:], gyro._rates[-120:]
    record.add('gyro', stamp_ns=stamps, rates=rates)
    few = Gyro()
    few._stamps_ns, few._rates = list(stamps), list(rates)
    few.noise_density, few.drift_density = gyro.noise_density, gyro.drift_density
    first, last = stamps[0], stamps[-1]
    rng = np.random.default_rng(1)
    for k in range(20):
        from_ns = int(rng.integers(first - 50_000_000, last))
        to_ns = from_ns + int(rng.integers(1, 3_000_000_000 if k % 4 == 0 else 200_000_000))
        before = state._replace(stamp_ns=from_ns)
        dt_s, measured, variance = few.rates(from_ns, to_ns)
        mean, mean_variance = few.mean_rate(from_ns, to_ns)
        record.add('between', run=len(record._arrays['gyro stamp_ns']) - 1, from_ns=from_ns,
                   to_ns=to_ns, before=before, after=few.propagate(before, to_ns), dt_s=dt_s,
                   measured=measured, variance=variance, mean=mean, mean_variance=mean_variance)


if __name__ == '__main__':
    everything = Record()
    for run, wanted in RUNS.items():
        record_run(everything, run, wanted)
    everything.save(RECORD)
    print(RECORD, RECORD.stat().st_size // 1000, 'kB')
