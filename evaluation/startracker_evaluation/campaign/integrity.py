# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Is a published attitude ever wrong? Long runs of the stages in conditions that mislead them.

The conditions of motions are in integrity_motion.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from startracker_evaluation.campaign.integrity_motion import (
    AT_S, FRAMES as MOTION_FRAMES, MAGNITUDE_LIMIT, MOTION_CONDITIONS, motion_runs,
    MotionCondition, onboard_stars, SIGMA_PX as MOTION_SIGMA_PX, star_tracker)
from startracker_ros.core.centroid.centroids import Centroids, UNKNOWN_EXPOSURE
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.maths.rotation import ARCSEC, conjugate, random_attitude, rotate, turned
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import with_preset
from startracker_ros.tools.datasheet.image_runs import (
    FRAMES as IMAGE_FRAMES, image_run, ImageCondition)
from startracker_ros.tools.datasheet.tally import CAMERA, START_NS, STEP_NS, Tally, tally_of_frame
from startracker_ros.tools.figures.correctness import WRONG_SHARE, WRONG_TEXT
from startracker_ros.tools.figures.rows import combined, share_below
from startracker_ros.tools.parallel import Trials

# --- images with the artefacts of real sensors ---

START_FRAMES = 10
"""Frames within which a start has to succeed."""

CLEAN_FRAMES = 10
_LINE_TIME_US = 20.0
_CM2 = (CAMERA.width * 5.5e-4) ** 2


def _smear(rate_deg_s: float, exposure_s: float = 0.1, needed_percent: float = 99.0,
           gyro: bool = False) -> ImageCondition:
    return ImageCondition(
        rate_deg_s, detector=DetectorOptions(motion_smear=True, exposure_s=exposure_s),
        gyro=gyro, needed_percent=needed_percent)


def _rolling(rate_deg_s: float, line_time_us: float, needed_percent: float) -> ImageCondition:
    return ImageCondition(rate_deg_s, detector=DetectorOptions(line_time_us=_LINE_TIME_US),
                          line_time_us=line_time_us, needed_percent=needed_percent)


def _shaken(needed_percent: float, vibration_arcsec: float = 0.0, kick_arcsec: float = 0.0
            ) -> ImageCondition:
    return ImageCondition(
        vibration_arcsec=vibration_arcsec, kick_arcsec=kick_arcsec,
        detector=DetectorOptions(motion_smear=True), needed_percent=needed_percent)


def _sway(sway_deg: float, sway_s: float, exposure_s: float = 0.1, line_time_us: float = 0.0
          ) -> ImageCondition:
    return ImageCondition(
        0.02, sway_deg=sway_deg, sway_s=sway_s, line_time_us=line_time_us,
        detector=DetectorOptions(
            motion_smear=True, exposure_s=exposure_s, line_time_us=line_time_us))


def _torn(rate_deg_s: float) -> ImageCondition:
    return ImageCondition(rate_deg_s, artefacts=ArtefactOptions(torn_frame_probability=0.5),
                          needed_percent=0.0)


def _hits(number: float) -> ImageCondition:
    """Return the condition of this mean number of cosmic-ray hits in each image of 0.1 s."""
    return ImageCondition(detector=DetectorOptions(cosmic_ray_hits_cm2_s=number / _CM2 / 0.1),
                          clean_frames=CLEAN_FRAMES)


def _spots(number: int) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(star_like_spots=number),
                          clean_frames=CLEAN_FRAMES)


def _debris(number: int, sigma_px: float, needed_percent: float = 95.0, **when: Any
            ) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(debris=number, debris_sigma_px=sigma_px),
                          needed_percent=needed_percent, **when)


def _trails(number: int) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(trails=number))


IMAGE_CONDITIONS = {
    'clean images': ImageCondition(),
    'smear 0.3 deg/s': _smear(0.3),
    'smear 1 deg/s': _smear(1.0),
    'smear 2 deg/s': _smear(2.0),
    'smear 3 deg/s': _smear(3.0),
    'smear 5 deg/s, 20 ms': _smear(5.0, 0.02, 95.0),
    'smear 10 deg/s, 20 ms': _smear(10.0, 0.02, 95.0),
    'smear 5 deg/s, gyro': _smear(5.0, needed_percent=95.0, gyro=True),
    'rolling shutter 0.1 deg/s': _rolling(0.1, _LINE_TIME_US, 99.0),
    'rolling shutter 1 deg/s': _rolling(1.0, _LINE_TIME_US, 99.0),
    'rolling shutter 0.1 deg/s, line time 0': _rolling(0.1, 0.0, 0.0),
    'rolling shutter 1 deg/s, line time 0': _rolling(1.0, 0.0, 0.0),
    'torn frames 0.14 deg/s': _torn(0.14),
    'torn frames 1 deg/s': _torn(1.0),
    '1 trail': _trails(1),
    '3 trails': _trails(3),
    '20 trails': _trails(20),
    '5 saturated columns and rows': ImageCondition(
        artefacts=ArtefactOptions(saturated_columns=5, saturated_rows=5)),
    '300 hits': _hits(300),
    '1000 hits': _hits(1000),
    '10000 hits': _hits(10_000),
    '50 spots': _spots(50),
    '100 spots': _spots(100),
    '300 spots': _spots(300),
    'start with 100 spots': ImageCondition(
        artefacts=ArtefactOptions(star_like_spots=100), start=True, frames=START_FRAMES,
        needed_percent=95.0),
    'debris, 150 of 3 px': _debris(150, 3.0, clean_frames=CLEAN_FRAMES),
    'debris, 300 points': _debris(300, 0.8, clean_frames=CLEAN_FRAMES),
    'start with debris, 150 of 3 px': _debris(150, 3.0, 90.0, start=True,
                                              frames=2 * START_FRAMES),
    'Moon in the field': ImageCondition(
        detector=DetectorOptions(blooming=True),
        artefacts=ArtefactOptions(moon_e=40_000.0, moon_distance_deg=2.0)),
    'Earth limb': ImageCondition(artefacts=ArtefactOptions(earth_e=20_000.0),
                                 needed_percent=95.0),
    'ghosts': ImageCondition(artefacts=ArtefactOptions(ghost_ratio=0.02)),
    'double exposure': ImageCondition(artefacts=ArtefactOptions(double_exposure_share=0.3),
                                      needed_percent=95.0),
    'stamp at the end': ImageCondition(0.5, artefacts=ArtefactOptions(stamp='end'),
                                       needed_percent=0.0, detectable=False),
    'defocus': ImageCondition(detector=DetectorOptions(psf_sigma_px=2.5), needed_percent=95.0),
    'defocus, ring of 3 px': ImageCondition(
        detector=DetectorOptions(defocus_ring_px=3.0), needed_percent=95.0),
    'timestamp errors of 5 ms': ImageCondition(
        0.3, artefacts=ArtefactOptions(stamp_jitter_ms=5.0), needed_percent=95.0),
    'stray light': ImageCondition(
        detector=DetectorOptions(stray_light_e=8_000.0), needed_percent=95.0),
    'coma': ImageCondition(detector=DetectorOptions(coma_corner_px=3.0), needed_percent=95.0),
    'repeated frames': ImageCondition(
        0.5, artefacts=ArtefactOptions(repeated_frame_probability=0.1), needed_percent=80.0),
    'repeated frames 0.002 deg/s': ImageCondition(
        0.002, artefacts=ArtefactOptions(repeated_frame_probability=0.3), needed_percent=60.0,
        clean_frames=CLEAN_FRAMES),
    'preset harsh': ImageCondition(
        detector=with_preset(DetectorOptions(), 'harsh'),
        artefacts=with_preset(ArtefactOptions(), 'harsh'),
        line_time_us=10.0, needed_percent=90.0),
    'vibration 10 arcsec': _shaken(99.0, vibration_arcsec=10.0),
    'vibration 40 arcsec': _shaken(95.0, vibration_arcsec=40.0),
    'vibration 100 arcsec': _shaken(0.0, vibration_arcsec=100.0),
    'kicks of 40 arcsec': _shaken(95.0, kick_arcsec=40.0),
    'kicks of 120 arcsec': _shaken(50.0, kick_arcsec=120.0),
    'kicks of 250 arcsec': _shaken(50.0, kick_arcsec=250.0),
    'sway 1 deg, 10 s': _sway(1.0, 10.0),
    'sway 0.2 deg, 2 s': _sway(0.2, 2.0),
    'sway 0.05 deg, 1 s': _sway(0.05, 1.0),
    'sway 0.05 deg, 1 s, exposed 10 ms': _sway(0.05, 1.0, 0.01),
    'sway 0.01 deg, 0.5 s': _sway(0.01, 0.5),
    'sway 5 deg, 30 s': _sway(5.0, 30.0),
    'sway 0.2 deg, 2 s, exposed 20 ms, rolling shutter': _sway(0.2, 2.0, 0.02, 80.0),
    'sway 0.05 deg, 1 s, exposed 20 ms, rolling shutter': _sway(0.05, 1.0, 0.02, 80.0),
}


def image_runs(name: str, runs: int, seed: int) -> Tally:
    """Return the tally of so many runs of a condition, with the seeds from seed on."""
    return sum((image_run(IMAGE_CONDITIONS[name], seed + run) for run in range(runs)), Tally())


# --- star lists, and the campaign ---

SIGMA_PX = 0.1
FRAMES = 400
# The gyro, and the motion between two frames, run at 100 Hz.
_SUBSTEPS = 10
_SUBSTEP_S = STEP_NS * 1e-9 / _SUBSTEPS
_PIECE = 4
LIST_RUNS = 5  # of star lists, which take less time, for each run of images,
MOTION_RUNS = 7  # and of lists of motions: the default shows whether a row holds


@dataclass(frozen=True)
class Condition:
    """
    What happens during a run.

    rate_deg_s is the size of a steady turn about a random axis; slew_deg_s the peak of slews
    with ramps of slew_deg_s2, jitter_deg_s of a roll that changes every second; false centroids
    come and go, missing is a share of the stars; dark_s one gap, jump a sudden other
    attitude; planet a bright point that moves among the stars, covered one half of the image for
    a while; gyro what becomes of the true rate, empty without a gyro. focal_ratio is that of
    the camera to the one of the pipeline. A run has so many frames, few where each costs an
    identification that cannot succeed. needed_percent of the frames must have an attitude.
    """

    rate_deg_s: float = 0.1
    slew_deg_s: float = 0.0
    slew_deg_s2: float = 0.5
    jitter_deg_s: float = 0.0
    false: int = 3
    missing: float = 0.05
    dark_s: float = 0.0
    jump: bool = False
    planet: bool = False
    covered: bool = False
    gyro: str = ''
    focal_ratio: float = 1.0
    mirrored: bool = False
    frames: int = FRAMES
    needed_percent: float = 95.0


CONDITIONS = {
    'steady turn': Condition(needed_percent=99.0),
    'steady turn, gyro': Condition(gyro='true', needed_percent=99.0),
    'jitter 0.5 deg/s': Condition(jitter_deg_s=0.5),
    'slews to 1 deg/s': Condition(slew_deg_s=1.0),
    'slews to 3 deg/s, gyro': Condition(slew_deg_s=3.0, gyro='true'),
    'slews, gyro in deg/s': Condition(slew_deg_s=0.5, gyro='degrees'),
    'slews, gyro with axes swapped': Condition(slew_deg_s=0.5, gyro='swapped'),
    '30 false, 20 % missing': Condition(false=30, missing=0.2),
    'dark for 2 s': Condition(dark_s=2.0, rate_deg_s=0.05, needed_percent=90.0),
    'dark for 2 s at 0.3 deg/s, gyro': Condition(
        dark_s=2.0, rate_deg_s=0.3, gyro='true', needed_percent=90.0),
    'dark for 10 s': Condition(dark_s=10.0, needed_percent=60.0),
    'turned away at once': Condition(jump=True, needed_percent=90.0),
    'planet passing': Condition(planet=True),
    'half of the image covered': Condition(covered=True, needed_percent=80.0),
    'focal length off by 1 %': Condition(
        focal_ratio=1.01, frames=20, needed_percent=0.0),
    'mirrored image': Condition(mirrored=True, frames=20, needed_percent=0.0),
    'false centroids only': Condition(
        false=40, missing=1.0, frames=20, needed_percent=0.0),
}
"""With the last three there is nothing to publish, or nothing that can be right."""

IMAGES_WRONG_SHARE = 2e-3
"""Share of the frames that may be wrong: what some thousand images can show."""

NEES_BOUNDS = 1.5, 3.8
"""
Bounds of the mean normalised squared error of 3 axes, of the supported conditions.

The lower one allows for motions that may begin in any frame, which the covariance contains.
Only the upper one holds where the camera is shaken within an exposure, or line_time_us is wrong:
what the covariance adds for that is not an error of each frame.
"""

_Any = Condition | ImageCondition | MotionCondition

ALL_CONDITIONS: dict[str, _Any] = {**CONDITIONS, **IMAGE_CONDITIONS, **MOTION_CONDITIONS}


@dataclass(frozen=True)
class IntegrityRow:
    """
    The tally of one condition; figures of attitudes are None where none is published.

    holds is None where nothing is to be detected, and where there are too few frames for the bound
    of the share that is wrong: wrong_below is its 95 % limit.
    """

    condition: str
    frames: int
    published_percent: float
    bound: str
    wrong: int
    gross: int
    wrong_below: float
    worst_sigma: float
    mean_nees: float | None
    sharp_nees: float | None
    wide_nees: float | None
    rates_beyond_5_sigma: int
    rates_mean_nees: float | None
    at_beyond_5_sigma: int | None
    at_mean_nees: float | None
    boresight_rms_arcsec: float | None
    losses: int
    holds: bool | None


def integrity_runs(name: str, trials: int, seed: int) -> Tally:
    """Return the tally of so many runs of one condition, or more of lists."""
    if name in IMAGE_CONDITIONS:
        return image_runs(name, trials, seed)
    if name in MOTION_CONDITIONS:
        # The runs have seeds in turn, as the trials of one part after the other.
        return motion_runs(name, MOTION_RUNS * trials, MOTION_RUNS * seed)
    rng = np.random.default_rng(seed)
    return sum((_run(CONDITIONS[name], rng) for _ in range(LIST_RUNS * trials)), Tally())


def _rates(condition: Condition, rng: np.random.Generator) -> np.ndarray:
    """Return the body rate (frames * _SUBSTEPS, 3) in rad/s."""
    count = condition.frames * _SUBSTEPS
    axis = rng.standard_normal((2, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rates = np.tile(axis[0] * condition.rate_deg_s, (count, 1))
    # Up, on, down and rest, each as long as chance will have it.
    time_s, begin_s = np.arange(count) * _SUBSTEP_S, rng.uniform(3, 6)
    while condition.slew_deg_s and begin_s < time_s[-1]:
        length_s = 2 * condition.slew_deg_s / condition.slew_deg_s2 + rng.uniform(1, 8)
        ramp = condition.slew_deg_s2 * np.minimum(time_s - begin_s, begin_s + length_s - time_s)
        rates += np.clip(ramp, 0, condition.slew_deg_s)[:, None] * axis[1]
        begin_s += length_s + rng.uniform(2, 6)
    blocks = rng.uniform(-1, 1, condition.frames // 10) * condition.jitter_deg_s
    rates[:, 2] += np.repeat(blocks, 10 * _SUBSTEPS)
    return np.radians(rates)


_GYROS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    'true': lambda rate: rate, 'degrees': np.degrees,
    'swapped': lambda rate: rate[:, [1, 2, 0]]}


def _gyro(condition: Condition, rates: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return what a gyro of 3 deg/h and 0.15 deg/sqrt(h) measures (N, 3) in rad/s."""
    drift = rng.normal(0, np.radians(3 / 3600), 3)
    noise = rng.normal(0, np.radians(0.15 / 60) / np.sqrt(_SUBSTEP_S), rates.shape)
    return _GYROS[condition.gyro](rates) + drift + noise


def _frames(condition: Condition, rates: np.ndarray, rng: np.random.Generator
            ) -> Iterator[tuple[np.ndarray, Centroids]]:
    """Yield the true attitude (4,) and the centroids of each frame."""
    taken_by = CAMERA.with_focal_ratio(condition.focal_ratio)
    q = random_attitude(rng)
    dark = _interval(condition.dark_s, rng)
    covered = _interval(5.0 if condition.covered else 0.0, rng)
    jump = rng.integers(50, FRAMES - 100) if condition.jump else -1
    # A planet starts in the middle of the image and leaves it slowly.
    planet = rotate(q, [0.0, 0.0, 1.0])
    drift = rng.normal(0, 3 * ARCSEC, 3)
    for frame in range(condition.frames):
        if frame:
            for rate in rates[(frame - 1) * _SUBSTEPS:frame * _SUBSTEPS]:
                q = turned(q, rate * _SUBSTEP_S)
        if frame == jump:
            q = random_attitude(rng)
        seen, _ = star_list(onboard_stars(), taken_by, q, SIGMA_PX, rng, missing=condition.missing,
                            false=condition.false, brightest_false=2.0)
        if condition.planet:
            planet = planet + drift
            seen = _with_point(seen, CAMERA.project(rotate(conjugate(q), planet)))
        if condition.mirrored:
            seen.uv[:, 0] = CAMERA.width - 1 - seen.uv[:, 0]
        if frame in covered:
            seen = seen.select(seen.uv[:, 0] > CAMERA.width / 2)
        yield q, seen.select(np.full(len(seen), frame not in dark))


def _interval(seconds: float, rng: np.random.Generator) -> range:
    """Return the frames of an interval that begins after the tracker has."""
    if not seconds:
        return range(0)
    count = round(seconds / (STEP_NS * 1e-9))
    begin = rng.integers(50, FRAMES - count - 50)
    return range(begin, begin + count)


def _with_point(seen: Centroids, uv: np.ndarray) -> Centroids:
    """Return the centroids with a bright one at uv (2,), if it is in the image."""
    if not CAMERA.contains(uv):
        return seen
    return Centroids(np.vstack([uv, seen.uv]),
                     np.append(2 * seen.flux.max(initial=1e4), seen.flux),
                     np.append(100.0, seen.snr), np.append(SIGMA_PX, seen.sigma_px))


def run_of(condition: Condition, rng: np.random.Generator,
           exposure_s: tuple[float, float] = UNKNOWN_EXPOSURE
           ) -> Iterator[tuple[StarTracker, FrameResult, np.ndarray, np.ndarray]]:
    """
    Run the pipeline from its start; yield it with its frame, the true attitude (4,) and rate (3,).

    The lists are of an instant; exposure_s are the limits of the exposure that they name.
    """
    pipeline = star_tracker()
    pipeline.reset()
    rates = _rates(condition, rng)
    measured = _gyro(condition, rates, rng) if condition.gyro else None
    for index, (truth, centroids) in enumerate(_frames(condition, rates, rng)):
        if measured is not None and index:
            for k in range((index - 1) * _SUBSTEPS, index * _SUBSTEPS):
                pipeline.add_rate(START_NS + (k + 1) * STEP_NS // _SUBSTEPS, measured[k])
        yield pipeline, pipeline.process_centroids(
            START_NS + index * STEP_NS, replace(centroids, exposure_s=exposure_s)), truth, rates[
                max(index * _SUBSTEPS - 1, 0)]


def _run(condition: Condition, rng: np.random.Generator) -> Tally:
    """Tally what the pipeline publishes in one run."""
    tally, before = Tally(), TrackerState.LOST
    for _, frame, truth, rate_rad_s in run_of(condition, rng):
        tally += tally_of_frame(frame, before, truth, rate_rad_s)
        before = frame.state
    return tally


def _row(name: str, condition: _Any, tally: Tally) -> IntegrityRow:
    share = 100 * tally.available / tally.due
    needed, (low, high) = condition.needed_percent, NEES_BOUNDS
    detectable, share_wrong = True, WRONG_SHARE
    if isinstance(condition, ImageCondition):
        detectable, share_wrong = condition.detectable, IMAGES_WRONG_SHARE
        low = 0.0 if condition.is_shaken else low
    elif isinstance(condition, MotionCondition) and condition.line_time_error:
        low = 0.0
    published, below = tally.published, share_below(tally.wrong, tally.frames)
    nees = tally.nees / published if published else None
    quarters = tally.nees_by_quarter() or (None, None)
    bound, holds = combined([
        (f'<= {share_wrong:g} wrong', tally.wrong <= share_wrong * tally.frames),
        ('0 gross', not tally.gross),
        (f'NEES {low:g} .. {high:g}' if low else f'NEES <= {high:g}',
         nees is None or low <= nees <= high),
        *([(f'>= {needed:g} % published', share >= needed)] if needed else [])], ', ')
    shown = detectable and (not holds or below <= share_wrong)
    return IntegrityRow(
        name, tally.frames, share, bound if detectable else 'not detectable', tally.wrong,
        tally.gross, below, tally.worst_sigma, nees,
        quarters[0], quarters[-1], tally.rates_wrong,
        tally.rates_nees / published if published else None,
        tally.at_wrong if tally.at else None, tally.at_nees / tally.at if tally.at else None,
        float(np.sqrt(tally.square_arcsec2 / (published or np.nan))), tally.losses,
        holds if shown else None)


def run_integrity_campaign(*, trials: int, seed: int, only: tuple[str, ...] = (),
                           scheduler: str = '') -> Result:
    """Follow trials runs in each condition, more of star lists."""
    names, tallies = tuple(dict.fromkeys(only or ALL_CONDITIONS)), Trials()
    for name in names:
        tallies.add(integrity_runs, (name,), trials, _PIECE,
                    seed + 7919 * list(ALL_CONDITIONS).index(name))
    rows = [_row(name, ALL_CONDITIONS[name], tally) for name, tally in zip(
        names, tallies.run(title='integrity', scheduler=scheduler))]
    return Result('campaign integrity', rows, {
        'camera': '1024 x 1024 px, 12 deg, 10 Hz; each run begins lost at a random attitude',
        'chain': 'centroids, lost-in-space identification, tracker (model attitude), trust',
        'star lists': f'centroids of {SIGMA_PX:g} px, stars to V {MAGNITUDE_LIMIT:g}; runs of '
                      f'{FRAMES} frames, or 20 where nothing can be right, {LIST_RUNS} for each '
                      'trial',
        'images': f'exposed 0.1 s where not stated; runs of {IMAGE_FRAMES} frames; hits, '
                  'spots and slow repetitions come after 10 clean frames',
        'lists of motions': f'the rows "list, ...": centroids of {MOTION_SIGMA_PX:g} px in the '
                            f'centre of the light; runs of {MOTION_FRAMES} frames, {MOTION_RUNS} '
                            'for each trial',
        'published_percent': 'star lists: of all frames; images and lists of motions: of the '
                             'frames after the two of a start, or after the clean ones; start '
                             f'with spots: of the runs, within {START_FRAMES} frames',
        'wrong': WRONG_TEXT,
        'wrong_below': '95 % limit of the share of the frames that is wrong, which are taken as '
                       'independent; worst_sigma is the largest error in sigma',
        'mean_nees': 'normalised squared error, 3 when the covariance is true; '
                     'sharp_nees: of the quarter of the attitudes with the least sigma',
        'rates_beyond_5_sigma': 'of the rates that go with the attitudes; no bound holds for them',
        'at_beyond_5_sigma': f'of at() {AT_S[0]:g} s and {AT_S[1]:+g} s away, in lists of '
                             'motions; no bound holds for them',
        'losses': 'times that the tracker went from TRACKING to another state',
        'trials': trials, 'seed': seed})
