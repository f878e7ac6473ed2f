# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pipeline's figures: accuracy, identification, database, core work, processes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
from rich.progress import track as progress
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.attitude.estimate import cramer_rao
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, random_attitude
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.table import Result
from startracker_ros.ros.processes import node_environment
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.correctness import is_correct
from startracker_ros.tools.figures.machine import machine, scheduling, StealTime
from startracker_ros.tools.figures.rows import PercentileRow

EPOCH_YEAR = 2026.5
START_NS = stamp_from_epoch_year(EPOCH_YEAR)
FULL_CAMERA = Camera.from_fov(1024, 1024, 12.0)
SMALL_CAMERA = Camera.from_fov(512, 512, 12.0)
"""The two cameras of the published figures: 42 and 84 arcsec a pixel."""

_LATENCY_GOALS = {'processes': (6.0, 10.0, 100.0), 'composed': (4.0, np.inf, 200.0)}
"""p50 and p95 in ms, and images a second, at 1024 px."""

_SHARE_GOALS_MS = {'processes': 2.0, 'composed': 1.0}
_CPU_GOALS_PERCENT = {'processes': 6.0, 'composed': 3.0}
_MEMORY_GOALS_MIB = {'processes': 250.0, 'composed': 100.0}
"""The median beyond the bare transport of the same images; processor time and memory at 10 Hz."""

_START_GOAL_S = 3.0
"""Of six nodes in a process each, to the first attitude."""

_LATENCY_RATE_HZ = {512: 100.0, 1024: 100.0, 2048: 20.0}


@contextmanager
def _empty_cache() -> Iterator[str]:
    """Let the pattern databases begin in an empty folder, which is returned."""
    before = os.environ.get('XDG_CACHE_HOME')
    with tempfile.TemporaryDirectory() as folder:
        os.environ['XDG_CACHE_HOME'] = folder
        try:
            yield folder
        finally:
            os.environ.pop('XDG_CACHE_HOME')
            if before is not None:
                os.environ['XDG_CACHE_HOME'] = before


def noise_free(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Images without noise, through extraction, identification and attitude."""
    rng = np.random.default_rng(seed)
    count = min(trials, 100)
    catalog = load_catalog()
    detector = DetectorOptions(noise=False, bit_depth=16, gain_e_per_dn=0.25)
    pipeline = StarTracker(FULL_CAMERA, EPOCH_YEAR)
    errors = []
    for _ in progress(range(count), 'noise-free', transient=True):
        options = MotionOptions(
            motion='inertial', ra_deg=rng.uniform(0, 360), roll_deg=rng.uniform(0, 360),
            dec_deg=np.degrees(np.arcsin(rng.uniform(-1, 1))))
        frame = SkySimulator(FULL_CAMERA, motion_from_options(options), catalog, EPOCH_YEAR,
                             detector_options=detector).frame(0.0)
        centroids = pipeline.extraction.extractor.measure(frame.image).centroids
        pipeline.motion.add_state(START_NS, frame.state.geocentric)
        identified = pipeline.identification.identify(START_NS, centroids)[0]
        solved = pipeline.attitude.from_stars(START_NS, centroids, identified.hip).attitude
        errors.append(np.full(3, np.nan) if solved is None else attitude_error(
            solved.quaternion, frame.state.q_icrf_from_sensor))
    cross = np.sqrt(np.mean(np.array(errors)[:, :2] ** 2)) / ARCSEC
    yield PercentileRow('noise-free images: cross-boresight error, rms', cross, unit='arcsec',
                        bound='< 0.1', holds=cross < 0.1)


def cramer_rao_ratio(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Single-frame attitude at 0.1 px against the bound of the same frames."""
    rng = np.random.default_rng(seed)
    onboard = onboard_catalog(load_catalog(), SMALL_CAMERA, EPOCH_YEAR, 6.0)
    stage = AttitudeStage(SMALL_CAMERA, EPOCH_YEAR)
    normalised, cross, bound = [], [], []
    for _ in range(trials):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, SMALL_CAMERA, q, 0.1, rng)
        solved = stage.from_stars(0, centroids, hip).attitude
        if solved is None:
            continue
        limit = cramer_rao(SMALL_CAMERA.unproject(centroids.uv),
                           centroids.sigma_px * SMALL_CAMERA.pixel_rad)
        error = attitude_error(solved.quaternion, q)
        normalised.append(error @ np.linalg.solve(limit, error) / 3)
        cross.append(error[:2])
        bound.append(np.diag(limit)[:2])
    ratio = float(np.sqrt(np.mean(normalised)))
    ours = float(np.sqrt(np.mean(np.square(cross)))) / ARCSEC
    limit_arcsec = float(np.sqrt(np.mean(bound))) / ARCSEC
    yield PercentileRow(
        '0.1 px, 12 deg, 512 px: cross-boresight error, rms', ours, unit='arcsec',
        peer=f'Cramer-Rao {limit_arcsec:.3f}', ratio=ours / limit_arcsec)
    yield PercentileRow('0.1 px, 12 deg, 512 px: three-axis error over the bound', ratio, unit='',
                        peer='Cramer-Rao 1', ratio=ratio, most=1.1)


def pyramid(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Lost-in-space identification of random attitudes without false stars."""
    rng = np.random.default_rng(seed)
    onboard = onboard_catalog(load_catalog(), SMALL_CAMERA, EPOCH_YEAR, 6.0)
    identifier = make_identifier(SMALL_CAMERA, EPOCH_YEAR,
                                 IdentificationOptions(magnitude_limit=6.0))
    solved = wrong = 0
    times_ms = []
    for _ in progress(range(trials), 'identification', transient=True):
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, SMALL_CAMERA, q, 0.3, rng)
        start_s = time.process_time()
        result = identifier.identify(centroids)
        times_ms.append((time.process_time() - start_s) * 1e3)
        if result.attitude is not None:
            right = is_correct(result.attitude.quaternion, q)
            solved, wrong = solved + right, wrong + (not right)
    case = '0.3 px, 12 deg, 512 px, V 6'
    yield PercentileRow(f'{case}: solved', 100 * solved / trials, unit='%', least=99)
    yield PercentileRow(f'{case}: wrong', wrong, unit='frames', exactly=0)
    yield PercentileRow(f'{case}: time, median', float(np.median(times_ms)), most=2)
    yield PercentileRow(f'{case}: time, p99', float(np.percentile(times_ms, 99)))


def database(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Time how long the pattern database takes to build, and to load from the cache."""
    with _empty_cache():
        for name, most in (('built', 2.0), ('out of the cache', 2.0)):
            start_s = time.perf_counter()
            make_identifier(SMALL_CAMERA, EPOCH_YEAR, IdentificationOptions(magnitude_limit=6.0))
            yield PercentileRow(f'database, 12 deg, V 6: {name}', time.perf_counter() - start_s,
                                unit='s', most=most)


def rendering(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Simulate 1024 x 1024 frames, plain and with every effect of the sensor."""
    everything = DetectorOptions(
        dark_current_e_s=50.0, hot_pixel_fraction=1e-3, flat_field_percent=1.0,
        stray_light_e=30.0, cosmic_ray_hits_cm2_s=5.0)
    for name, detector in (('plain', DetectorOptions()), ('all sensor effects', everything)):
        simulator = SkySimulator(FULL_CAMERA, motion_from_options(), load_catalog(), EPOCH_YEAR,
                                 detector_options=detector, seed=seed)
        simulator.frame(0.0)
        times_ms = []
        for index in progress(range(min(trials, 100)), 'rendering', transient=True):
            start_s = time.process_time()
            simulator.frame(index / 10)
            times_ms.append((time.process_time() - start_s) * 1e3)
        yield PercentileRow(f'rendering, 1024 px, {name}: median', float(np.median(times_ms)),
                            most=10)


def core_work(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Centroids, tracking and attitude of 1024 x 1024 frames on one core."""
    count = min(trials, 100)
    cv2.setNumThreads(1)
    catalog = load_catalog()
    options = MotionOptions(motion='constant_rate', rate_deg_s=(0.05, 0.1, 0.02))
    simulator = SkySimulator(FULL_CAMERA, motion_from_options(options), catalog, EPOCH_YEAR,
                             seed=seed)
    pipeline = StarTracker(FULL_CAMERA, EPOCH_YEAR)
    stages: dict[str, list[float]] = {'centroids': [], 'tracking': [], 'attitude': []}
    for index in progress(range(count + 2), 'core work', transient=True):
        stamp_ns = START_NS + index * 100_000_000
        frame = simulator.frame(index / 10)
        image = frame.image
        pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
        marks = [time.process_time()]
        centroids = pipeline.extraction.extractor.measure(image).centroids
        marks.append(time.process_time())
        tracks = pipeline.tracker.update(stamp_ns, centroids)
        marks.append(time.process_time())
        pipeline.attitude.from_tracks(
            stamp_ns, tracks or Tracks.empty(), pipeline.tracker.attitude)
        marks.append(time.process_time())
        if not pipeline.identifier_is_idle(stamp_ns):
            pipeline.identify(stamp_ns, centroids)
        else:
            for stage, elapsed_s in zip(stages.values(), np.diff(marks)):
                stage.append(elapsed_s * 1e3)
    for name, times_ms in stages.items():
        yield PercentileRow(f'core work, 1024 px: {name}, median', float(np.median(times_ms)))
    total = float(np.median(np.sum(list(stages.values()), axis=0)))
    yield PercentileRow('core work, 1024 px: all, median', total, most=15)


def processes(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Run the demo, each node a process, from an empty cache and from a full one."""
    with _empty_cache() as folder:
        for run in ('first', 'second'):
            # As a user starts it, so that its own start-up counts.
            done = subprocess.run(
                [sys.executable, '-m', 'startracker_ros', 'demo', '--seconds', '15', '--json',
                 '--seed', str(seed), '--output', str(Path(folder) / run)],
                env=node_environment(), stdout=subprocess.PIPE, text=True)
            document = json.loads(done.stdout)
            figures = {row['case']: row['ours'] for row in document['rows']}
            yield PercentileRow(f'processes, {run} run: start to first attitude',
                                figures['process start to first attitude'], unit='s',
                                most=_START_GOAL_S)
            yield PercentileRow(f'processes, {run} run: frames dropped',
                                figures['frames dropped'], unit='frames', exactly=0)
            for name in ('p50', 'p95'):
                case = f'image sent to attitude received, {name}'
                yield PercentileRow(f'processes, {run} run: {case}', figures[case])


def latency(trials: int, seed: int) -> Iterator[PercentileRow]:
    """Image to attitude through the nodes, stage by stage, and how many images a second."""
    from startracker_ros.ros.rig import LogFolder
    for size in (512, 1024, 2048):
        with LogFolder('latency') as folder:
            yield from _latency_of_size(size, folder, trials, seed)


def _latency_of_size(size: int, folder: Path, trials: int, seed: int) -> Iterator[PercentileRow]:
    """Send the same images, of one field with noise of their own, every way that there is."""
    from startracker_evaluation.harness.latency import (
        CAMERA_RATE_HZ, core_ms, crossing_ms, measure)
    simulator = SkySimulator(Camera.from_fov(size, size, 12.0),
                             motion_from_options(MotionOptions(motion='inertial')),
                             load_catalog(), EPOCH_YEAR, seed=seed)
    images = folder / 'images'
    images.mkdir()
    for index in range(8):
        cv2.imwrite(str(images / f'{index}.png'), simulator.frame(0.0).image)
    rate_hz, count = _LATENCY_RATE_HZ[size], min(trials, 1000)
    yield PercentileRow.of_times(
        f'{size} px: image to attitude in one process, without messages',
        core_ms(images, 12.0, EPOCH_YEAR, rate_hz=rate_hz, count=count))
    bare_ms = crossing_ms(images, 12.0, folder, rate_hz=rate_hz, count=count)
    yield PercentileRow.of_times(
        f'{size} px: image to a process that does nothing with it', bare_ms)
    for composed in (False, True):
        mode = 'composed' if composed else 'processes'
        case = f'{size} px, {mode}'
        goals = _LATENCY_GOALS if size == 1024 else {}
        p50_ms, p95_ms, least_hz = goals.get(mode, (np.inf, np.inf, None))
        result = measure(images, 12.0, folder, composed=composed, rate_hz=rate_hz, count=count)
        for stage, times_ms in result.stages_ms.items():
            yield PercentileRow.of_times(f'{case}: {stage}', times_ms)
        yield PercentileRow.of_times(f'{case}: image to attitude', result.total_ms, p50_ms, p95_ms)
        yield PercentileRow.of_times(f'{case}: image to attitude at {CAMERA_RATE_HZ:g} Hz',
                                     result.camera_rate_ms)
        # Composed with their source the stages receive an image without any transport.
        transport_ms = result.stages_ms['transport and decoding'] if composed else bare_ms
        share_ms = float(np.median(result.total_ms) - np.median(transport_ms))
        yield PercentileRow(f'{case}: image to attitude without the transport of the image',
                            share_ms, most=_SHARE_GOALS_MS[mode] if goals else None)
        yield PercentileRow(f'{case}: processor time of the nodes at {CAMERA_RATE_HZ:g} Hz',
                            result.cpu_percent, unit='%',
                            most=_CPU_GOALS_PERCENT[mode] if goals else None)
        yield PercentileRow(f'{case}: memory of the nodes at {CAMERA_RATE_HZ:g} Hz, Pss',
                            result.memory_mib, unit='MiB',
                            most=_MEMORY_GOALS_MIB[mode] if goals else None)
        yield PercentileRow(f'{case}: images a second', result.highest_hz, unit='Hz',
                            least=least_hz)


CASES: dict[str, Callable[[int, int], Iterator[PercentileRow]]] = {
    'noise-free': noise_free, 'cramer-rao': cramer_rao_ratio, 'pyramid': pyramid,
    'database': database, 'rendering': rendering, 'core-work': core_work, 'processes': processes,
    'latency': latency}


def run_pipeline_bench(*, trials: int, seed: int, only: Sequence[str] = tuple(CASES)) -> Result:
    """Run the named cases one after another."""
    steal_time = StealTime()
    rows = [row for name in only for row in CASES[name](trials, seed)]
    return Result('bench pipeline', rows, {
        'machine': machine(scheduling(), str(steal_time)),
        'times': 'process CPU time of one thread, except start-up, database and the way of images '
                 '(wall time; from image to attitude at the full rate the run of three with the '
                 'smallest median)',
        'Cramer-Rao bound': 'takes the noise of all pixels as equal in angle; off the axis they '
                            'are finer by up to 2 %, so the ratio may fall below 1',
        'trials': trials, 'seed': seed})
