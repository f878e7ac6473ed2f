# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Several heads fused: accuracy compared with its bounds, consistency, mounts, faults."""

from collections.abc import Callable, Sequence
import time

import numpy as np
from startracker_evaluation.campaign.heads_scene import (
    errors_of, NAMES, Scene, SceneRun, SIGMA_ARCSEC, UNDERSTATED, UNDERSTATED_BY, WRONG_GYROS)
from startracker_evaluation.campaign.integrity import CONDITIONS, NEES_BOUNDS, run_of
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.head import HeadFrame
from startracker_ros.core.fusion.mounts import MountOptions
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, random_attitude, turned)
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.track.track_filter import TrackFilter
from startracker_ros.core.track.tracks import Hint
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.correctness import (
    count_wrong, nees_of, verdict, WRONG_SHARE, WRONG_TEXT, WrongCount)
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.parallel import Trials

# --- frames of the real tracker as measurements of a fusion ---

_TRACKER_SETTLED = 10  # frames after a start
_EXPOSURE_S = (0.0, 0.0)  # an unknown one would be a doubt in the covariance of a frame

TRACKER_CONDITIONS = ('steady turn', 'slews to 1 deg/s', 'mirrored image',
                      'focal length off by 1 %')
"""Of the integrity campaign; the last two must give a fusion nothing."""


def tracker_runs(condition: str, runs: int, seed: int) -> np.ndarray:
    """
    Return sums over so many runs, (1, 9).

    Frames, frames with frame_attitude, the sum of its NEES and of its squared errors in arcsec^2
    (3); pairs of frames in a row, and the sum of the products of their normalised errors of
    frame_attitude (1) and of tracked_attitude (1), means of the three axes.
    """
    rng, sums = np.random.default_rng(seed), np.zeros(9)
    for _ in range(runs):
        before: tuple[np.ndarray, np.ndarray] | None = None
        for index, (pipeline, frame, truth, _) in enumerate(run_of(
                    CONDITIONS[condition], rng, _EXPOSURE_S)):
            measured = pipeline.tracker.frame_attitude
            sums[0] += 1
            if measured is None or frame.tracked is None or index < _TRACKER_SETTLED:
                before = None
                continue
            error = attitude_error(measured.quaternion, truth)
            tracked = frame.tracked.attitude
            both = (_whitened(error, measured.covariance_sensor), _whitened(
                attitude_error(tracked.quaternion, truth), tracked.covariance_sensor))
            sums[1:3] += 1, both[0] @ both[0]
            sums[3:6] += np.square(error / ARCSEC)
            if before is not None:
                sums[6:9] += 1, both[0] @ before[0] / 3, both[1] @ before[1] / 3
            before = both
    return sums[None]


def _whitened(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.linalg.cholesky(covariance), error)


def tracker_rows(condition: str, rows: np.ndarray) -> list[Row]:
    """Return the rows of one condition out of sums (parts, 9)."""
    measured, nees, x2, y2, z2, pairs, product, tracked_product = rows.sum(axis=0)[1:]
    if condition in ('mirrored image', 'focal length off by 1 %'):
        return [Row(f'tracker, {condition}: frames for a fusion', measured, 'frames', exactly=0)]
    correlation = product / pairs
    return [
        Row(f'tracker, {condition}: NEES of frame_attitude', nees / measured, '', least=2.7,
            most=3.3),
        Row(f'tracker, {condition}: correlation of its frames in a row', correlation, '',
            '<= 0.05', abs(correlation) <= 0.05),
        Row(f'tracker, {condition}: the same of tracked_attitude', tracked_product / pairs, ''),
        Row(f'tracker, {condition}: error across the boresight',
            float(np.sqrt((x2 + y2) / 2 / measured)), 'arcsec'),
        Row(f'tracker, {condition}: error in roll', float(np.sqrt(z2 / measured)), 'arcsec')]


# --- re-acquisition of a head by a hint ---

_CAMERA, _EPOCH_YEAR = Camera.from_fov(1024, 1024, 12.0), 2026.5
_HINT_RAD = np.radians(1.0)
_RATE = np.radians([0.2, -0.1, 0.3])
_MOST_STARS, _FAINTEST, _SIGMA_PX = 40, 6.5, 0.1
_HINT_AGE_S, _STEP_S = 0.2, 0.2
_STARTS, _LAST = 40, 5  # in a run; frames after which a start has failed


def hint_runs(runs: int, seed: int) -> np.ndarray:
    """
    Return frames to an attitude, whether it is wrong and gross, processor time in ms of starts.

    The time is that of the first frame: tracker, identification lost in space, start.
    """
    rng, epoch_ns = np.random.default_rng(seed), stamp_from_epoch_year(_EPOCH_YEAR)
    sky = onboard_catalog(load_catalog(), _CAMERA, _EPOCH_YEAR, _FAINTEST)
    stage = IdentificationStage(_CAMERA, _EPOCH_YEAR)
    rows = []
    for start in range(_STARTS * runs):
        q, tracker = random_attitude(rng), TrackFilter(_CAMERA, sky)
        first_ns = epoch_ns + start * 10 ** 9
        hinted = turned(turned(q, -_RATE * _HINT_AGE_S), _HINT_RAD * rng.standard_normal(3))
        tracker.add_hint(Hint(first_ns - round(_HINT_AGE_S * 1e9), hinted,
                              np.eye(3) * _HINT_RAD ** 2, _RATE, np.eye(3) * 1e-10))
        spent_s = []
        for frame in range(_LAST):
            stamp_ns, truth = first_ns + round(frame * _STEP_S * 1e9), turned(
                q, _RATE * frame * _STEP_S)
            centroids, _ = star_list(sky, _CAMERA, truth, _SIGMA_PX, rng)
            centroids = centroids.select(np.argsort(-centroids.flux)[:_MOST_STARS])
            begin_s = time.process_time()
            tracker.update(stamp_ns, centroids)
            identified, used = stage.identify(stamp_ns, centroids)
            tracker.identified(stamp_ns, used, identified.hip)
            spent_s.append(time.process_time() - begin_s)
            if tracker.attitude is not None:
                break
        rows.append([*_start_result(tracker, truth, len(spent_s)), spent_s[0] * 1e3])
    return np.array(rows)


def _start_result(tracker: TrackFilter, truth: np.ndarray, frames: int
                  ) -> tuple[float, float, float]:
    """Return frames to an attitude, infinite without one, and whether it is wrong and gross."""
    tracked = tracker.attitude
    if tracked is None:
        return np.inf, 0.0, 0.0
    estimate = tracked.attitude
    return frames, *verdict(estimate.quaternion, estimate.covariance_sensor, truth)


def hint_rows(case: str, rows: np.ndarray) -> list[Row]:
    """Return the rows of starts (N, 4)."""
    frames, (wrong, gross) = float(rows[:, 0].max()), rows[:, 1:3].sum(axis=0)
    spent_ms = float(np.median(rows[:, 3]))
    return [Row('re-acquisition by a hint of 1 deg: starts', len(rows), ''),
            Row('re-acquisition by a hint of 1 deg: frames, at most', frames, 'frames', most=1),
            *(Row(f're-acquisition by a hint of 1 deg: {kind} attitudes', count, '',
                  exactly=0) for kind, count in (('wrong', wrong), ('gross', gross))),
            Row('re-acquisition by a hint of 1 deg: processor time', spent_ms, 'ms', most=0.5)]


# --- fused heads ---

_KNOWN = MountOptions(mount_sigma_arcsec=0.0, mount_walk_arcsec_sqrt_h=0.0)
_LEARNT = MountOptions(mount_sigma_arcsec=3.0)
FAULTS = ('mount wrong by 1 deg', 'time offset 0.2 s', 'jump of 1 deg')
FRAMES = 2000
_UNDERSTATED_HEADS = {'one head': 1, 'two heads alike': 2}
_HEAD_FRAMES_S = 0.2
_SETTLED = 300  # frames at the start of a run that are not compared with a bound of the end
_PIECE = 5
_LONG_RUNS = 25  # short runs for each long one


def _begun(scene: Scene, options: MountOptions, seed: int) -> tuple[SceneRun, AttitudeFusion]:
    run = SceneRun(scene, np.random.default_rng(seed))
    return run, AttitudeFusion(run.mount_file(), FusionOptions(), options, GyroErrorOptions())


def _run(scene: Scene, options: MountOptions, seed: int) -> tuple[SceneRun, AttitudeFusion, list]:
    run, fusion = _begun(scene, options, seed)
    return run, fusion, list(run.events(fusion))


def _wrong(errors: np.ndarray, covariances: np.ndarray) -> WrongCount:
    """Count errors (N, 3) that their covariances (N, 3, 3) make wrong attitudes."""
    return count_wrong(errors, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)))


def _wrong_rows(case: str, wrong: float, gross: float) -> list[Row]:
    return [Row(f'{case}: {kind} attitudes', count, 'frames', exactly=0)
            for kind, count in (('wrong', wrong), ('gross', gross))]


def _seconds(heads: int) -> float:
    return FRAMES / heads * _HEAD_FRAMES_S


def two_heads(seed: int) -> np.ndarray:
    """
    Return rms error over posterior bound (3,), and rms error in arcsec (3,).

    The body turns at a constant rate but for the acceleration of the process noise; without gyro.
    """
    scene = Scene(_seconds(2), heads=2, gyro=False, wobble_deg_s=0.0, synchronous=True,
                  acceleration_deg_s2=FusionOptions().acceleration_deg_s2)
    run, _, outcomes = _run(scene, _KNOWN, seed)
    errors, _ = errors_of(outcomes)
    # Both heads have frames at one stamp: the second attitude has both.
    stamps = np.array([one.fused.stamp_ns for one in outcomes])
    last = np.append(stamps[1:] != stamps[:-1], True)
    rms = np.sqrt(np.mean(np.square(errors[last][_SETTLED:]), axis=0))
    return np.concatenate([rms / _posterior_bound(run), rms / ARCSEC])


def _posterior_bound(run: SceneRun) -> np.ndarray:
    """
    Return the posterior Cramer-Rao bound (3,) rad of each body axis in the steady state.

    The information matrix of attitude and rate (Tichavsky, Muravchik and Nehorai 1998): J <-
    (Q + F J^-1 F^T)^-1 + sum over the heads of H^T R^-1 H.
    """
    dt_s = run.scene.period_s
    q = np.radians(run.scene.acceleration_deg_s2) ** 2 * 0.1
    F = np.eye(6)
    F[:3, 3:] = dt_s * np.eye(3)
    Q = q * np.kron([[dt_s ** 3 / 3, dt_s ** 2 / 2], [dt_s ** 2 / 2, dt_s]], np.eye(3))
    measured = np.zeros((6, 6))
    for mount in run.mounts:
        R = matrix_from_quaternion(mount)
        measured[:3, :3] += R @ np.diag((SIGMA_ARCSEC * ARCSEC) ** -2.0) @ R.T
    J = measured + 1e-6 * np.eye(6)
    for _ in range(500):
        J = np.linalg.inv(Q + F @ np.linalg.inv(J) @ F.T) + measured
    return np.sqrt(np.diag(np.linalg.inv(J))[:3])


def snapshots(runs: int, seed: int) -> np.ndarray:
    """
    Return squared errors over the combined Cramer-Rao bound (N, 3) of two heads at one time.

    Each is a start: two frames of the first head, of which the older one tells no more than a
    rate, and one of the second.
    """
    run, fusion = _begun(Scene(1.0, heads=2), _KNOWN, seed)
    rng, information, rows = np.random.default_rng(seed), np.zeros((3, 3)), []
    covariance = np.diag(np.square(SIGMA_ARCSEC * ARCSEC))
    for mount in run.mounts:
        R = matrix_from_quaternion(mount)
        information += np.linalg.inv(R @ covariance @ R.T)
    for _ in range(1000 * runs):
        fusion.reset()
        for head, tick in ((0, 0), (0, 1), (1, 1)):
            fused = fusion.add_frame(NAMES[head], HeadFrame(run.stamp_ns(tick), turned(
                run.mounts[head], SIGMA_ARCSEC * ARCSEC * rng.standard_normal(3)), covariance))
        if fused is not None:
            rows.append(2 * np.sign(fused.quaternion[3]) * fused.quaternion[:3])
    return np.square(rows) / np.diag(np.linalg.inv(information))


def dropping(seed: int) -> list[float]:
    """
    Return sum of NEES, fused frames, wrong and gross ones, processor time in us.

    Three heads at other times and with other delays, the second always out of order.
    """
    scene = Scene(_seconds(3), drop_s=15.0, delays_s=(0.0, 0.12, 0.03))
    _, _, outcomes = _run(scene, _KNOWN, seed)
    errors, covariances = errors_of(outcomes)
    return [nees_of(errors, covariances).sum(), len(errors), *_wrong(errors, covariances),
            _frame_cpu_us(Scene(20.0, delays_s=scene.delays_s), seed)]


def _frame_cpu_us(scene: Scene, seed: int) -> float:
    """Return the processor time of the fusion for a frame, with the rates that come with it."""
    run, fusion = _begun(scene, _LEARNT, seed)
    inputs = [(head, run.stamp_ns(tick), value) for head, tick, value in run.inputs()]
    begin_s = time.process_time()
    for head, stamp_ns, value in inputs:
        if isinstance(value, HeadFrame):
            fusion.add_frame(NAMES[head], value)
        else:
            fusion.add_rate(stamp_ns, value)
    frames = sum(head >= 0 for head, _, _ in inputs)
    return (time.process_time() - begin_s) / frames * 1e6


_MOTIONS = {
    'no gyro, constant rate': Scene(_seconds(3), gyro=False, wobble_deg_s=0.0),
    'no gyro, rate that varies by 0.3 deg/s in 100 s': Scene(
        _seconds(3), gyro=False, wobble_deg_s=0.3),
    'no gyro, rate that varies by 2 deg/s in 100 s': Scene(
        _seconds(3), gyro=False, wobble_deg_s=2.0),
    'no gyro, random accelerations of 0.02 deg/s^2': Scene(
        _seconds(3), gyro=False, wobble_deg_s=0.0, acceleration_deg_s2=0.02),
    **{f'gyro with {wrong}': Scene(_seconds(3), turn_deg_s=0.3, wobble_deg_s=0.5, wrong_gyro=wrong)
       for wrong in WRONG_GYROS}}


def motions(motion: str, seed: int) -> list[float]:
    """Return sum of NEES, fused frames, wrong and gross ones."""
    _, _, outcomes = _run(_MOTIONS[motion], _KNOWN, seed)
    errors, covariances = errors_of(outcomes)
    return [nees_of(errors, covariances).sum(), len(errors), *_wrong(errors, covariances)]


def faults(fault: str, seed: int) -> list[float]:
    """Return fused, wrong and gross frames and those until the exclusion."""
    begin_s = 30.0 if fault == 'jump of 1 deg' else 0.0
    run, _, outcomes = _run(Scene(_seconds(3), fault=fault, fault_s=begin_s), _LEARNT, seed)
    errors, covariances = errors_of(outcomes)
    after = run.excluded_after
    return [len(errors), *_wrong(errors, covariances), np.inf if after is None else after]


def understated(heads: str, seed: int) -> list[float]:
    """
    Return the figures of a run with one head or two alike.

    Mean NEES, wrong and gross frames, all after _SETTLED; wrong frames before, least found scale,
    heads named, heads named falsely; frames after _SETTLED.
    """
    run, fusion, outcomes = _run(
        Scene(_seconds(3), fault=UNDERSTATED, faulty_heads=_UNDERSTATED_HEADS[heads]), _KNOWN,
        seed)
    errors, covariances = errors_of(outcomes)
    before, after = slice(0, _SETTLED), slice(_SETTLED, None)
    faulty = [NAMES[head] for head in run.all_faulty]
    named = {name for name, head in fusion.heads.items() if head.stands_out}
    return [nees_of(errors[after], covariances[after]).mean(),
            *_wrong(errors[after], covariances[after]),
            _wrong(errors[before], covariances[before]).wrong,
            min(fusion.heads[name].noise_scale for name in faulty) ** 0.5,
            len(named & {*faulty}), len(named - {*faulty}), len(errors[after])]


def bending(law: str, seed: int) -> list[float]:
    """Return rms of the misalignments in arcsec, before and after learning."""
    scene = Scene(4 * 5700.0, period_s=1.0, bend_arcsec=6.4 * (law == 'orbit'),
                  temperature_arcsec_k=1.0 * (law == 'temperature'))
    run, fusion = _begun(scene, MountOptions(
        mount_sigma_arcsec=3.0, mount_orbit_arcsec=6.0 * (law == 'orbit'),
        mount_temperature_arcsec_k=1.0 * (law == 'temperature'),
        mount_walk_arcsec_sqrt_h=0.1, orbit_period_s=5700.0), seed)
    before, after = [], []
    for frame, one in enumerate(run.events(fusion)):
        if one.fused.stamp_ns > run.stamp_ns(0) + 3 * 5700e9 and not frame % 10:
            found = np.array([fusion.mounts.misalignment(name, one.fused.stamp_ns)[0]
                              for name in NAMES])
            before.append(np.sum(one.misalignment[1:] ** 2, axis=1))
            after.append(np.sum((found - one.misalignment)[1:] ** 2, axis=1))
    return [np.sqrt(np.mean(before)) / ARCSEC, np.sqrt(np.mean(after)) / ARCSEC]


def steps(seed: int) -> list[float]:
    """
    Return s until a step is found, error of its date in s and of its size in arcsec.

    Then the number of false steps.
    """
    scene = Scene(2400.0, period_s=0.4, step_arcsec=5.0, step_s=1201.0)
    run, fusion = _begun(scene, _LEARNT, seed)
    row = [np.inf, np.inf, np.inf, 0.0]
    for one in run.events(fusion):
        for step in fusion.steps:
            found_s = (one.fused.stamp_ns - run.stamp_ns(0)) * 1e-9 - scene.step_s
            if found_s < 0 or step.head != NAMES[-1] or np.isfinite(row[0]):
                row[3] += 1
                continue
            date_s = (step.stamp_ns - run.stamp_ns(0)) * 1e-9 - scene.step_s
            size = np.linalg.norm(step.size_rad / ARCSEC - run.step)
            row[:3] = [found_s, abs(date_s), float(size)]
        fusion.steps.clear()
    return row


_RUNS: dict[str, Callable[..., Sequence[float] | np.ndarray]] = {
    'two heads': two_heads, 'dropping': dropping, 'motions': motions, 'faults': faults,
    'understated': understated, 'bending': bending, 'steps': steps}
"""One run each, of a case where the task has several, by its seed."""

_PARTS: dict[str, Callable[..., np.ndarray]] = {
    'snapshots': snapshots, 'hint': hint_runs, 'tracker': tracker_runs}
"""So many runs of one random generator."""


def heads_runs(task: str, case: str, runs: int, seed: int) -> np.ndarray:
    """Return the figures of so many runs of one task."""
    of_case = [case] if case else []
    if task in _PARTS:
        return _PARTS[task](*of_case, runs, seed)
    return np.array([_RUNS[task](*of_case, seed + index) for index in range(runs)])


def run_heads_campaign(*, trials: int, seed: int, only: tuple[str, ...] = (),
                       scheduler: str = '') -> Result:
    """Fuse heads in so many runs of FRAMES frames for each figure; only names tasks."""
    long_runs = max(1, trials // _LONG_RUNS)
    cases = [('two heads', '', trials), ('snapshots', '', trials), ('dropping', '', trials),
             *(('motions', motion, trials) for motion in _MOTIONS),
             *(('faults', fault, trials) for fault in FAULTS),
             *(('understated', heads, trials) for heads in _UNDERSTATED_HEADS),
             *(('bending', law, long_runs) for law in ('orbit', 'temperature')),
             ('steps', '', long_runs), ('hint', '', long_runs),
             *(('tracker', condition, long_runs) for condition in TRACKER_CONDITIONS)]
    cases = [case for case in cases if not only or case[0] in only]
    figures = Trials()
    for task, case, runs in cases:
        figures.add(heads_runs, (task, case), runs, _PIECE, seed)
    all_rows = [row for (task, case, _), rows in zip(cases, figures.run(
        title='heads', scheduler=scheduler)) for row in _ROWS[task](case, rows)]
    return Result('campaign heads', all_rows, {
        'heads': 'boresights 90 deg apart, 5 Hz at other times, errors of frame_attitude: '
                 + ' '.join(f'{sigma:g}' for sigma in SIGMA_ARCSEC) + ' arcsec about x, y, z',
        'gyro': '20 Hz, 0.15 deg/sqrt(h), 1 deg/h; none for the rows of two heads and "no gyro"',
        'gyro with ...': 'body at 0.3 deg/s, which varies by 0.5 deg/s in 100 s',
        'dropping': 'each head is blinded for 15 s in turn; delays of 0, 0.12 and 0.03 s',
        'faults': 'mounts known to 3 arcsec, body at 0.1 deg/s; wrong: ' + WRONG_TEXT,
        'bending': 'frames of 1 Hz, the fourth orbit after three',
        'tracker': 'frames of the real tracker in conditions of `campaign integrity`, '
                   'with their exposures',
        'trials': trials, 'seed': seed})


def _rows_two_heads(case: str, rows: np.ndarray) -> list[Row]:
    ratio, rms = np.sqrt(np.mean(np.square(rows), axis=0)).reshape(2, 3)
    # The boresight of the first head is the z axis of the body.
    cross = np.sqrt(np.mean(np.square(rms[:2])))
    return [Row('two heads 90 deg apart: roll over cross error of the first', rms[2] / cross, '',
                most=1.3),
            *(Row(f'constant rate, {axis}: rms over posterior bound', value, '',
                  most=1.1) for axis, value in zip('xyz', ratio))]


def _rows_snapshots(case: str, rows: np.ndarray) -> list[Row]:
    ratio = np.sqrt(np.mean(rows, axis=0))
    return [Row(f'one frame of two heads, {axis}: rms over Cramer-Rao bound', value, '',
                most=1.05) for axis, value in zip('xyz', ratio)]


def _rows_dropping(case: str, rows: np.ndarray) -> list[Row]:
    nees, frames, wrong, gross = rows[:, :4].sum(axis=0)
    cpu_us = float(np.median(rows[:, 4]))
    low, high = NEES_BOUNDS
    return [Row('heads drop in and out: mean NEES', nees / frames, '', least=low, most=high),
            Row('heads drop in and out: fused frames', frames, 'frames'),
            *_wrong_rows('heads drop in and out', wrong, gross),
            Row('processor time of a frame', cpu_us, 'us', most=300)]


def _rows_motions(case: str, rows: np.ndarray) -> list[Row]:
    nees, frames, wrong, gross = rows.sum(axis=0)
    low, high = NEES_BOUNDS
    return [Row(f'{case}: mean NEES', nees / frames, '', least=low, most=high),
            Row(f'{case}: wrong attitudes', wrong, 'frames', f'<= {WRONG_SHARE:g} of the frames',
                wrong <= WRONG_SHARE * frames),
            Row(f'{case}: gross attitudes', gross, 'frames', exactly=0)]


def _rows_faults(case: str, rows: np.ndarray) -> list[Row]:
    frames, wrong, gross = rows[:, :3].sum(axis=0)
    after = float(rows[:, 3].max())
    return [Row(f'{case}: fused frames', frames, 'frames'),
            *_wrong_rows(case, wrong, gross),
            Row(f'{case}: excluded after, at most', after, 'frames', most=10)]


def _rows_understated(case: str, rows: np.ndarray) -> list[Row]:
    name, wanted = f'{case}, {UNDERSTATED}', _UNDERSTATED_HEADS[case] * len(rows)
    wrong, gross, before, _, named, falsely, frames = rows[:, 1:].sum(axis=0)
    return [Row(f'{name}: mean NEES', rows[:, 0].mean(), ''),
            Row(f'{name}, once found: wrong attitudes', wrong, 'frames',
                f'<= {WRONG_SHARE:g} of the frames', wrong <= WRONG_SHARE * frames),
            Row(f'{name}, once found: gross attitudes', gross, 'frames', exactly=0),
            Row(f'{name}: wrong attitudes in the first {_SETTLED} frames', before, 'frames'),
            Row(f'{name}: found scale of {UNDERSTATED_BY:g}', rows[:, 4].mean(), ''),
            Row(f'{name}: heads named', named, 'heads', exactly=wanted),
            Row(f'{name}: heads named falsely', falsely, 'heads', exactly=0)]


def _rows_bending(case: str, rows: np.ndarray) -> list[Row]:
    before, after = np.sqrt(np.mean(np.square(rows), axis=0))
    return [Row(f'bending with the {case}: without learning', before, 'arcsec'),
            Row(f'bending with the {case}: after three orbits', after, 'arcsec', most=0.3)]


def _rows_steps(case: str, rows: np.ndarray) -> list[Row]:
    found_s, date_s, size = rows[:, :3].max(axis=0)
    false = rows[:, 3].sum()
    return [Row('step of 5 arcsec: found after, at most', found_s, 's', most=600),
            Row('step of 5 arcsec: error of its date', date_s, 's', most=60),
            Row('step of 5 arcsec: error of its size', size, 'arcsec'),
            Row('false steps found', false, 'steps', exactly=0)]


_ROWS = {'two heads': _rows_two_heads, 'snapshots': _rows_snapshots, 'dropping': _rows_dropping,
         'motions': _rows_motions, 'faults': _rows_faults, 'understated': _rows_understated,
         'bending': _rows_bending, 'steps': _rows_steps, 'hint': hint_rows,
         'tracker': tracker_rows}

TASKS = tuple(_ROWS)
"""What can be run alone."""
