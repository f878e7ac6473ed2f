# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Association, stars in view and models of stars in real runs: what goes in and what comes out.

python test/native_bank_record.py writes test/native/bank.npz from the functions of the package,
to compare those of the native core with. Keys are kind/number/name.
"""

from collections import defaultdict
from pathlib import Path
import sys
from unittest import mock

from native_bank import (
    CAMERAS, centroid_structs, hint_struct, options_struct, RECORD, SOLVERS, TRACK)
import numpy as np
from startracker_evaluation.campaign import jpdaf_methods, jpdaf_runs
from startracker_evaluation.campaign.integrity import CONDITIONS, run_of
from startracker_evaluation.campaign.integrity_motion import MOTION_CONDITIONS, motion_frames
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import project
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_quaternion, sensor_directions, turned)
from startracker_ros.core.maths.rotation import quaternion_from_pointing, rotate
from startracker_ros.core.papers.independent_stars import IndependentStarsModel, rolled
from startracker_ros.core.papers.neighbourhood import propagated, star_neighbourhood
from startracker_ros.core.track import attitude_model, start, track_filter
from startracker_ros.core.track.association import associate
from startracker_ros.core.track.correction import _pixel_covariance
from startracker_ros.core.track.frame_motion import rate_between_frames
from startracker_ros.core.track.model import StarModel
from startracker_ros.core.track.motion_models import (
    body_rate, constant_velocity, coordinated_turn, image_flows, image_jacobian, moved_by,
    turn_curvature)
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rotation_fit import fit_rotation
from startracker_ros.core.track.tracks import Hint

sys.path.append(str(Path(__file__).parent / 'core' / 'track'))
from star_motion import CAMERA, Motion, sky  # noqa: E402, I100, I202

LISTS = {'30 false, 20 % missing': 60, 'slews to 3 deg/s, gyro': 40, 'turned away at once': 40}
EVERY = {'association': 9, 'visible': 12, 'predicted': 12, 'new': 6, 'identified': 2}
CELLS = (('linear', 0.5, 0.02), ('turning', 0.5, 0.03))
METHODS = (
    {}, {'association': 'diffuse'}, {'association': 'normalised'}, {'sna_confirmation': True},
    {'roll_by_gyro': True}, {'solver': 'triad'}, {'model': 'sna'})
MODEL_FRAMES = 4


class Record(defaultdict):
    """Cases by kind."""

    def __init__(self) -> None:
        super().__init__(list)
        self._calls = defaultdict(int)

    def add(self, kind: str, **arrays) -> None:
        self._calls[kind] += 1
        if self._calls[kind] % EVERY.get(kind, 1) == 0:
            self[kind].append({name: np.array(value) for name, value in arrays.items()})

    def write(self) -> None:
        np.savez_compressed(RECORD, **{
            f'{kind}/{number}/{name}': value for kind, cases in self.items()
            for number, case in enumerate(cases) for name, value in case.items()})


# --- what the attitude model and the filter of tracks ask for ---


def recorded_lists(record: Record) -> None:
    correct = attitude_model.correct

    def recorded_correct(lens, icrf, usable, min_stars, predicted, uv, error, delay_s, detection):
        result = correct(lens, icrf, usable, min_stars, predicted, uv, error, delay_s, detection)
        sensor = sensor_directions(matrix_from_quaternion(predicted.quaternion), icrf)
        inside = result.inside
        P = _pixel_covariance(image_flows(lens, sensor[inside]),
                              np.ascontiguousarray(predicted.covariance[:3, :3]))
        place = project(lens, sensor[inside])
        probability, unassociated = associate(place, P, uv, error, detection)
        record.add('association', predicted=place, covariance=P, uv=uv, error=error,
                   detection=detection, probability=probability, unassociated=unassociated)
        return result

    def wrapped(name, kind):
        function = getattr(track_filter, name)

        def call(*arguments):
            result = function(*arguments)
            record.add(kind, **kinds[kind](arguments, result))
            return result
        return mock.patch.object(track_filter, name, call)

    kinds = {
        'visible': lambda given, found: {
            'q': given[2].quaternion, 'rate': given[3], 'faintest': given[4], 'uv': found[0],
            'velocity': found[1]},
        'predicted': lambda given, found: {
            'q': given[3].quaternion, 'covariance': given[3].covariance_sensor, 'rate': given[4],
            'options': options_struct(given[5]), 'uv': found.uv, 'velocity': found.velocity,
            'sigma_px': found.sigma_px, 'hip': found.hip},
        'new': lambda given, found: {
            'q': given[2].quaternion, 'covariance': given[2].covariance_sensor, 'uv': given[3],
            'flux': given[4], 'sigma_px': given[5], 'zero_point': given[6],
            'tolerance': given[7], 'hip': given[0].onboard.hip[found[0]], 'centroid': found[1]},
        'identified': lambda given, found: {
            'options': options_struct(given[2]), 'centroids': centroid_structs(given[4]),
            'hip': given[6], **({} if found[0] is None else {
                'found': given[1].onboard.hip[found[0].star_index],
                'uv': found[0].centroids.uv, 'q': found[0].attitude.quaternion,
                'covariance': found[0].attitude.covariance_sensor, 'scale': found[0].scale})}}
    with (mock.patch.object(attitude_model, 'correct', recorded_correct),
          wrapped('visible_stars', 'visible'), wrapped('predict_stars', 'predicted'),
          wrapped('match_new_stars', 'new'), wrapped('fit_identified', 'identified')):
        for name, frames in LISTS.items():
            for index, (pipeline, *_) in enumerate(run_of(
                    CONDITIONS[name], np.random.default_rng(10))):
                _ = pipeline.tracker.predicted if hasattr(pipeline, 'tracker') else None
                if index == frames:
                    break
        name = 'list, torques of 0.2 deg/s^2, 2 s, exposed 0.1 s'
        for _ in motion_frames(MOTION_CONDITIONS[name], np.random.default_rng(10), 30):
            pass


# --- functions of any input ---


def recorded_functions(record: Record) -> None:
    for number, camera in enumerate(CAMERAS * 4):
        rng = np.random.default_rng(number)
        dt_s, count = rng.uniform(0.02, 1.0), 24
        rate = rng.normal(0, 0.05, 3) * (number % 4 > 0)
        uv, variance = rng.uniform(5, 500, (count, 2)), rng.uniform(0.01, 0.3, count)
        noise = np.abs(rng.normal(0, 1, 2))
        P = rng.normal(0, 1e-3, (3, 3))
        P = P @ P.T
        jacobian = image_jacobian(camera, camera.unproject(uv))
        velocity = jacobian @ rate + rng.normal(0, 0.1, (count, 2))
        error = variance[:, None, None] * [[1.0, 0.2], [0.2, 2.0]]
        record.add(
            'motion', camera=number % len(CAMERAS), dt_s=dt_s, rate=rate, uv=uv,
            variance=variance, noise=noise, P=P, velocity=velocity, error=error,
            constant=np.concatenate(constant_velocity(dt_s, tuple(noise))),
            turning=np.concatenate(coordinated_turn(dt_s, 9 * rate[2], tuple(noise))),
            rolled=rolled(camera, rate[2], dt_s), curvature=turn_curvature(camera, uv, rate, dt_s),
            moved=np.concatenate([each.reshape(count, -1) for each in moved_by(
                camera.lens, uv, variance, rate, P)], axis=1),
            propagated=propagated(camera, uv, rate, dt_s),
            body_rate=np.vstack(body_rate(jacobian, velocity, error)))
        seen = propagated(camera, uv, rate, 0.1) + rng.normal(0, 0.1, uv.shape)
        seen[~np.isfinite(seen)] = 700.0
        flux = 10 ** rng.uniform(2, 4, count)
        before, after = (Centroids(
            np.concatenate([each, rng.uniform(5, 500, (6, 2))]),
            np.append(flux * rng.uniform(0.9, 1.1, count), rng.uniform(100, 1e4, 6)),
            np.full(count + 6, 20.0), np.full(count + 6, 0.1),
            delay_s=rng.uniform(0, 0.01, count + 6) * (number % 2)) for each in (uv, seen))
        found = rate_between_frames(camera, before, after, 0.1)
        record.add('frames', camera=number % len(CAMERAS), before=centroid_structs(before),
                   after=centroid_structs(after), rate=np.empty(0) if found is None else found)
        quaternion = quaternion_from_pointing(*rng.uniform(0, 1, 3))
        icrf = rotate(quaternion, camera.unproject(uv))
        measured = np.concatenate([uv[4:], uv[:9], rng.uniform(5, 500, (9, 2))])
        measured += rng.normal(0, 0.08, measured.shape)
        sigma = rng.uniform(0.05, 0.2, len(measured))
        predicted = uv + rng.normal(0, 0.4 * (number % 3), uv.shape)
        record.add('neighbours', camera=number % len(CAMERAS), predicted=predicted, icrf=icrf,
                   uv=measured, sigma_px=sigma, assigned=star_neighbourhood(
                       camera, predicted, icrf, measured, sigma))
        sigma, seen = rng.uniform(0.05, 0.2, count), uv + rng.normal(0, 0.1, uv.shape)
        seen[:number % 4] += rng.normal(0, 5, (number % 4, 2))
        candidate = rng.random(count) < 0.9
        solver = SOLVERS[number % len(SOLVERS)]
        fit = fit_rotation(camera, icrf, seen, sigma, candidate, solver)
        record.add(
            'fit', camera=number % len(CAMERAS), solver=number % len(SOLVERS), icrf=icrf,
            uv=seen, sigma_px=sigma, candidate=candidate, attitude=np.concatenate([
                fit.attitude.quaternion, fit.attitude.covariance_sensor.ravel()]),
            figures=[fit.scale, fit.residual_px, fit.attitude.chi2, fit.attitude.stars],
            normalised=fit.normalised, inlier=fit.inlier)


def covariance(rng: np.random.Generator, sigma: float) -> np.ndarray:
    root = rng.normal(0, sigma, (3, 3))
    return root @ root.T


def recorded_starts(record: Record) -> None:
    none, stars = Centroids.empty(), np.empty(0, int)
    for number in range(12):
        rng = np.random.default_rng(number)

        first, second = (start.IdentifiedFrame(
            stamp_ns, stars, none, AttitudeEstimate(quaternion, covariance(rng, 1e-5)), scale)
            for stamp_ns, quaternion, scale in (
                (10 ** 9, quaternion_from_pointing(1.0, 0.5, 0.2), 1.0),
                (2 * 10 ** 9, turned(quaternion_from_pointing(1.0, 0.5, 0.2),
                                     rng.normal(0, 0.02, 3)), 1.5)))
        two = start.start_of_two(first, second)
        hint = Hint(
            int(1.5e9), turned(second.attitude.quaternion, rng.normal(0, 10.0 ** -rng.integers(
                1, 6), 3)), covariance(rng, 10.0 ** -rng.integers(1, 5)), rng.normal(0, 0.01, 3),
            covariance(rng, 10.0 ** -rng.integers(2, 5)))
        hinted = start.HintedStart()
        hinted.add(hint)
        found = [hinted.start(second, 0.6), start.start_of_prediction(hint, second),
                 hinted.start(second, 0.4)]
        record.add(
            'starts', scales=[first.scale, second.scale], hint=hint_struct(*hint),
            first=hint_struct(first.stamp_ns, first.attitude.quaternion,
                              first.attitude.covariance_sensor),
            second=hint_struct(second.stamp_ns, second.attitude.quaternion,
                               second.attitude.covariance_sensor),
            **{name: np.empty(0) if one is None else np.concatenate([
                one.rate, one.rate_covariance.ravel(), one.cross.ravel()])
               for name, one in zip(('two', 'hinted', 'predicted', 'late'), [two, *found])})


# --- models of stars ---


def tracks_of(bank) -> np.ndarray:
    made = np.zeros(len(bank), TRACK)
    for name in TRACK.names:
        made[name] = getattr(bank, 'star_index' if name == 'star' else name)
    return made


class RecordedModel:
    """Records a model of stars from its start on."""

    def __init__(self, record: Record) -> None:
        self._record, self._roll = record, (0.0, 0.0, 0.0)
        self._added, self._number = [], -1
        self.restart()

    def restart(self) -> None:
        """Record the next start: others of the same run are left out."""
        self._is_started = self._is_on = False

    def patches(self):
        start, update, add, roll = (
            IndependentStarsModel.start, IndependentStarsModel.update, StarModel.add,
            IndependentStarsModel._measured_roll)
        own = self

        def recorded_start(model, given):
            own._roll = 0.0, 0.0, 0.0
            start(model, given)
            own._frames, own._added = 0, []
            own._is_on = not own._is_started
            if not own._is_on:
                return
            own._is_started = True
            own._number += 1
            own._record.add(
                'start', options=options_struct(model._options), roll=own._roll, hint=hint_struct(
                    given.frame.stamp_ns, given.frame.attitude.quaternion,
                    given.frame.attitude.covariance_sensor, given.rate, given.rate_covariance))

        def recorded_roll(model, from_ns, to_ns):
            found = roll(model, from_ns, to_ns)
            own._roll = (found is not None, found or 0.0, model._gyro.noise_density)
            return found

        def recorded_add(model, track_id, star_index, centroids, *, confirmed):
            if isinstance(model, IndependentStarsModel):
                own._added.append((star_index, centroid_structs(centroids), confirmed))
            add(model, track_id, star_index, centroids, confirmed=confirmed)

        def recorded_update(model, stamp_ns, frame, sky):
            before = model.bank
            own._roll = 0.0, 0.0, 0.0
            result = update(model, stamp_ns, frame, sky)
            own._frames += 1
            if not own._is_on or own._frames > MODEL_FRAMES:
                return result
            added, own._added = own._added, []
            fit = result.fit
            own._record.add(
                'update', model=own._number, stamp_ns=stamp_ns, roll=own._roll,
                added=np.concatenate([np.empty(0, int), *(one[0] for one in added)]),
                added_centroids=np.concatenate([
                    centroid_structs(frame)[:0], *(one[1] for one in added)]),
                added_confirmed=np.concatenate([
                    np.empty(0, bool), *(np.full(len(one[0]), one[2]) for one in added)]),
                before=before.star_index, confirmed=before.confirmed,
                icrf=sky.direction(before.star_index), centroids=centroid_structs(frame),
                tracks=tracks_of(model.bank), good=result.good,
                unassociated=result.unassociated, rate=model.rate_rad_s,
                rate_covariance=model.rate_covariance, uses_gyro=model.uses_gyro,
                trouble=bool(model.gyro_trouble), **({} if fit is None else {
                    'attitude': np.concatenate([
                        fit.attitude.quaternion, fit.attitude.covariance_sensor.ravel()]),
                    'figures': [fit.scale, fit.residual_px, fit.attitude.chi2,
                                fit.attitude.stars], 'normalised': fit.normalised}))
            return result

        return (mock.patch.object(IndependentStarsModel, 'start', recorded_start),
                mock.patch.object(IndependentStarsModel, 'update', recorded_update),
                mock.patch.object(IndependentStarsModel, '_measured_roll', recorded_roll),
                mock.patch.object(StarModel, 'add', recorded_add))


def recorded_models(record: Record) -> None:
    recorded = RecordedModel(record)
    patches = recorded.patches()
    for patch in patches:
        patch.start()
    for number, cell in enumerate(CELLS):
        run = jpdaf_runs.make_run(jpdaf_runs.Cell(*cell), np.random.default_rng(number))
        for method in METHODS:
            recorded.restart()
            jpdaf_methods.track(
                run, jpdaf_methods.tracker_options(run.cell, method), 'roll_by_gyro' in method)
    for model in ('constant_velocity', 'coordinated_turn', 'sna'):
        recorded.restart()
        motion = Motion(sky(5.5), (0.1, 0.4, 1.5), missed=0.1, false_points=10, seed=1)
        tracker = track_filter.TrackFilter(CAMERA, motion.onboard, TrackerOptions(
            model=model, max_stars=20, confirm_frames=2))
        for k in range(2 + MODEL_FRAMES):
            stamp_ns, centroids, hip = motion.frame(k)
            tracker.update(stamp_ns, centroids)
            tracker.identified(stamp_ns, centroids, hip)
    for patch in patches:
        patch.stop()


if __name__ == '__main__':
    made = Record()
    recorded_lists(made)
    recorded_models(made)
    recorded_functions(made)
    recorded_starts(made)
    made.write()
    print({kind: len(cases) for kind, cases in made.items()},
          RECORD.stat().st_size // 1000, 'kB')
