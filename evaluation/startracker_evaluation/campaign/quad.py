# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Quad identification along an orbit and over the whole sky, compared with the published figures.

Yuan, Zhang, Shi 2017: 300 consecutive simulated images, in initial and in tracking mode.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
import os
from pathlib import Path

import numpy as np
from startracker_evaluation.campaign.centroid import (
    EPOCH_YEAR as NIGHT_EPOCH_YEAR, known_attitude, solutions)
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.extras import new_figure
from startracker_ros.core.identify.identification import FieldStars, IdentificationOptions
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, multiply, quaternion_from_pointing,
    quaternion_from_rotation_vector, radec_from_unit, random_attitude, unit_from_radec)
from startracker_ros.core.papers.quad import base_quads, matching_quads, QuadIdentifier
from startracker_ros.io.images.images import read_image
from startracker_ros.io.output import save_picture
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.tools.figures.correctness import (
    CORRECT_BORESIGHT_DEG, CORRECT_TEXT, is_correct, right_and_wrong)
from startracker_ros.tools.figures.rows import Check, judged, PaperRow
from startracker_ros.tools.figures.timing import cpu_timed
from startracker_ros.tools.parallel import (
    joined, parallel_map, parallel_trials, split_trials)

EPOCH_YEAR = 2010.0
CAMERA = Camera.from_fov(1024, 1024, 20.3)
OPTIONS = IdentificationOptions(method='quad', magnitude_limit=5.5, max_image_stars=100)
SIGMA_PX = 0.5
STEP_S = 5.0

METHODS = 'as published', 'initial', 'tracking', 'pyramid'
"""The paper's steps; the method of the node, lost in space and near the frame before; a peer."""

# That of ALOS: sun-synchronous, looks to the zenith. The quarter of a revolution was chosen for
# its stars, as many to an image as in the paper.
ORBIT = MotionOptions(motion='low_earth_orbit', altitude_km=691.65, inclination_deg=98.16,
                      node_deg=240.0, latitude_deg=190.0)
REAL_IMAGES = {'night-sky-11deg': (NIGHT_EPOCH_YEAR, True), 'night-sky-6deg': (2019.0, False)}
"""Folders of real images, each with its epoch and whether it has the stars of the paper's."""
# As far as the image moves between two frames along the orbit.
_MOVED_DEG = 0.3
_PART_TRIALS = 50
_WARM_UP = 5
_PAPER_TRIALS = 300


@dataclass(frozen=True)
class Frames:
    """
    Results of F frames.

    quaternion (F, 4) is q_icrf_from_sensor by QUEST with apparent places, and error_rad (F, 3)
    its error about sensor axes, NaN where unsolved; stars (F,) counts those in the image.
    solved, wrong and time_ms (F, M) are those of METHODS; time is NaN where a mode has no frame
    before. identified and misidentified (F, 2) count stars by the steps of the paper and by the
    method of the node.
    """

    quaternion: np.ndarray
    stars: np.ndarray
    solved: np.ndarray
    wrong: np.ndarray
    time_ms: np.ndarray
    identified: np.ndarray
    misidentified: np.ndarray
    error_rad: np.ndarray


@cache
def _identifier() -> QuadIdentifier:
    return QuadIdentifier(CAMERA, EPOCH_YEAR, OPTIONS)


@cache
def _pyramid() -> PyramidIdentifier:
    return PyramidIdentifier(CAMERA, EPOCH_YEAR, replace(OPTIONS, method='pyramid'))


def orbit_options() -> MotionOptions:
    """Return the motion along the orbit with the camera to the zenith at time 0."""
    position_m, _ = ORBIT.orbit.at(0.0)
    ra_rad, dec_rad = map(float, radec_from_unit(position_m / np.linalg.norm(position_m)))
    return replace(ORBIT, ra_deg=float(np.degrees(ra_rad)), dec_deg=float(np.degrees(dec_rad)))


def orbit_frames(begin: int, count: int, seed: int) -> Frames:
    """Return frames begin to begin + count along the orbit."""
    motion = motion_from_options(orbit_options())
    states = [motion.at(STEP_S * (begin + i)) for i in range(count)]
    return _frames([state.q_icrf_from_sensor for state in states],
                   [state.velocity_m_s for state in states], np.random.default_rng(seed),
                   consecutive=True)


def sky_frames(count: int, seed: int) -> Frames:
    """Return frames at random attitudes, without a frame before."""
    rng = np.random.default_rng(seed)
    return _frames([random_attitude(rng) for _ in range(count)], [np.zeros(3)] * count, rng,
                   consecutive=False)


def _frames(attitudes: list[np.ndarray], velocities: list[np.ndarray], rng: np.random.Generator,
            *, consecutive: bool) -> Frames:
    warm = np.random.default_rng(0)
    for _ in range(_WARM_UP):
        q = random_attitude(warm)
        _frame(q, np.zeros(3), q, warm)
    rows, before = [], None
    for q, velocity_m_s in zip(attitudes, velocities):
        row, solution = _frame(q, velocity_m_s, before, rng)
        rows.append(row)
        before = solution if consecutive else None
    return Frames(*(np.array(column) for column in zip(*rows)))


def _frame(q: np.ndarray, velocity_m_s: np.ndarray, before: np.ndarray | None,
           rng: np.random.Generator) -> tuple[tuple, np.ndarray | None]:
    """Return one row of Frames, and the attitude found, which predicts the next frame."""
    identifier = _identifier()
    observer_state = state_near_earth(EPOCH_YEAR, velocity_m_s)
    onboard = identifier.onboard
    apparent = replace(onboard, direction=apparent_directions(onboard.direction, observer_state))
    centroids, hip = star_list(apparent, CAMERA, q, SIGMA_PX, rng)
    field = identifier.field_stars(centroids)
    published_s, (star, quaternion) = cpu_timed(published, identifier, field)
    initial_s, initial = cpu_timed(identifier.identify, centroids)
    tracked_s, tracked = np.nan, initial
    if before is not None:
        tracked_s, tracked = cpu_timed(identifier.identify_near, centroids, before)
    pyramid_s, other = cpu_timed(_pyramid().identify, centroids)
    times_s = published_s, initial_s, tracked_s, pyramid_s
    solutions = [quaternion, *(found.attitude.quaternion if found.attitude is not None else None
                               for found in (initial, tracked, other))]
    named = np.where(star >= 0, onboard.hip[star], 0)
    counts = [right_and_wrong(named, hip[field.index]), right_and_wrong(initial.hip, hip)]
    right, false = zip(*counts)
    fitted, error_rad = np.full(4, np.nan), np.full(3, np.nan)
    chosen = np.flatnonzero(tracked.hip)
    if tracked.attitude is not None:
        fitted = estimate_attitude(
            CAMERA.unproject(centroids.uv[chosen]),
            apparent.direction[onboard.index_of(tracked.hip[chosen])],
            centroids.sigma_px[chosen] * CAMERA.pixel_rad).quaternion
        error_rad = attitude_error(fitted, q)
    solved = [solution is not None for solution in solutions]
    wrong = [solution is not None and not is_correct(solution, q) for solution in solutions]
    return ((fitted, len(hip), solved, wrong, [1e3 * time_s for time_s in times_s], right, false,
             error_rad), solutions[2])


def published(identifier: QuadIdentifier, field: FieldStars
              ) -> tuple[np.ndarray, np.ndarray | None]:
    """
    Return the catalogue star (N,) of each image star, -1 for none, and the attitude by QUEST.

    The steps of the paper, without our verification: the first base quad that is one catalogue
    quad alone, and the full field matched by triangles with it.
    """
    none = np.full(len(field), -1)
    if len(field) < 4:
        return none, None
    options = identifier.options
    for base in base_quads(len(field)):
        quads = matching_quads(
            identifier.pairs, identifier.pairs.direction, field.direction[base],
            field.sigma_rad[base], options.tolerance_sigmas, identifier.scale_error)
        if len(quads) != 1:
            continue
        star = identifier.verifier.field_match(field.direction, field.sigma_rad, base,
                                               identifier.pairs.star[quads[0]])
        known = np.flatnonzero(star >= 0)
        try:
            attitude = estimate_attitude(field.direction[known],
                                         identifier.onboard.direction[star[known]],
                                         field.sigma_rad[known])
        except AttitudeError:
            continue
        return star, attitude.quaternion
    return none, None


def _database() -> Iterator[PaperRow]:
    pairs = _identifier().pairs
    assert isinstance(pairs, PairDatabase)
    for name, ours, paper in (('stars', len(pairs.star), 2827),
                              ('pairs', len(pairs.separation), 269421)):
        yield PaperRow(f'database: {name}', paper, ours, None, name, '0.9 .. 1.1 of the paper',
                       0.9 <= ours / paper <= 1.1)


def _summary(case: str, frames: Frames, in_paper: bool) -> Iterator[PaperRow]:
    """Yield the rows of one case; in_paper when the paper has figures for it."""
    count = len(frames.stars)
    judge = partial(judged, trials=count, needed=_PAPER_TRIALS)

    def paper(figure: float | str) -> float | str | None:
        return figure if in_paper else None

    def both(name: str, figure: float, values: tuple[float, float], unit: str,
             *checks: Check) -> PaperRow:
        return PaperRow(f'{case}: {name}', paper(figure), *values, unit, *judge(checks))

    yield PaperRow(f'{case}: stars in an image, fewest', paper(14), int(frames.stars.min()), None,
                   'stars')
    yield PaperRow(f'{case}: stars in an image, most', paper(23), int(frames.stars.max()), None,
                   'stars')
    right = 100 * (frames.solved & ~frames.wrong).mean(0)
    wrong = frames.wrong.sum(0)
    # The paper has no poor fields, which need not all be solved.
    least = 100.0 if in_paper else 99.0
    # Beyond its own images the method of the paper is not bound.
    bound, first = ('both', 0) if in_paper else ('beyond', 1)
    yield both('identified, initial mode', 100, (right[0], right[1]), '%',
               (f'{bound} >= {least:g}', min(right[first:2]) >= least))
    yield both('wrong, initial mode', 0, (int(wrong[0]), int(wrong[1])), 'frames',
               (f'{bound} = 0', not wrong[first:2].any()))
    shares = [100 * counts.sum(0) / frames.stars.sum()
              for counts in (frames.identified, frames.misidentified)]
    for name, (share, holds) in {
            'stars identified': (shares[0], (f'{bound} >= 99', min(shares[0][first:]) >= 99)),
            'stars misnamed': (shares[1], (f'{bound} <= 0.1', max(shares[1][first:]) <= 0.1))
            }.items():
        yield PaperRow(f'{case}: {name}', None, float(share[0]), float(share[1]), '%',
                       *judge([holds]))
    times = frames.time_ms
    tracked = np.isfinite(times[:, 2])
    for name, measure, limit in (('mean', np.mean, 72.6), ('worst', np.max, 128.6)):
        yield PaperRow(f'{case}: time, initial mode, {name}', paper(limit),
                       float(measure(times[:, 0])), float(measure(times[:, 1])), 'ms')
        yield PaperRow(f'{case}: time, the Pyramid on the same frames, {name}', None, None,
                       float(measure(times[:, 3])), 'ms')
        if tracked.any():
            tracking_ms, initial_ms = (float(measure(times[tracked, column]))
                                       for column in (2, 1))
            checks = [(f'<= initial, {initial_ms:.3g}', tracking_ms <= initial_ms)]
            yield PaperRow(f'{case}: time, tracking mode, {name}', None, None, tracking_ms, 'ms',
                           *(judge(checks) if name == 'mean' else ('', True)))
    if tracked.any():
        yield from _tracking_rows(case, frames, right[2], int(wrong[2]))


def _tracking_rows(case: str, frames: Frames, right: float, wrong: int) -> Iterator[PaperRow]:
    """Yield what tracking mode identifies, the rate of both modes, and the errors of QUEST."""
    judge = partial(judged, trials=len(frames.stars), needed=_PAPER_TRIALS)
    yield PaperRow(f'{case}: identified, tracking mode', 100, None, right, '%',
                   *judge([('>= 100', right >= 100)]))
    yield PaperRow(f'{case}: wrong, tracking mode', 0, None, wrong, 'frames',
                   *judge([('= 0', wrong == 0)]))
    for mode, column in (('initial', 1), ('tracking', 2)):
        yield PaperRow(f'{case}: output, {mode} mode', '13 Hz', None,
                       1e3 / float(np.nanmean(frames.time_ms[:, column])), 'Hz')
    error = frames.error_rad[np.isfinite(frames.error_rad).all(1)] / ARCSEC
    for name, columns in (('across', error[:, :2]), ('roll', error[:, 2])):
        yield PaperRow(f'{case}: error of QUEST, {name}, rms', None, None,
                       float(np.sqrt((columns ** 2).mean())), 'arcsec')


def real_frames(folder: Path, epoch_year: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return times in ms, solved and right, each (F, 3), of the real images of a folder.

    Columns are the paper's steps, the method of the node lost in space, and the same near an
    attitude that is _MOVED_DEG off, for the images are not a sequence. Those that nobody solved
    are left out.
    """
    rows = []
    for known in solutions(folder):
        if not known['ra_deg']:
            continue
        image = read_image(folder / known['file'])
        camera = Camera.from_fov(image.shape[1], image.shape[0], float(known['hfov_deg']))
        identifier = QuadIdentifier(camera, epoch_year, replace(
            OPTIONS, magnitude_limit=0.0, fov_error_percent=1.0))
        centroids = CentroidExtractor(ExtractionOptions(method='squared', max_stars=30)).measure(
            image).centroids
        published_s, (_, quaternion) = cpu_timed(
            published, identifier, identifier.field_stars(centroids))
        initial_s, initial = cpu_timed(identifier.identify, centroids)
        tracked_s, tracked = np.nan, initial
        if initial.attitude is not None:
            tracked_s, tracked = cpu_timed(identifier.identify_near, centroids, multiply(
                initial.attitude.quaternion,
                quaternion_from_rotation_vector(np.radians([_MOVED_DEG, 0.0, 0.0]))))
        found = [quaternion, *(None if each.attitude is None else each.attitude.quaternion
                               for each in (initial, tracked))]
        rows.append(([1e3 * time_s for time_s in (published_s, initial_s, tracked_s)],
                     [q is not None for q in found],
                     [q is not None and _is_right(q, known) for q in found]))
    times_ms, solved, right = (np.array(column) for column in zip(*rows))
    return times_ms, solved, right


def _is_right(quaternion: np.ndarray, known: dict[str, str]) -> bool:
    """Return whether an attitude is that of a row of solutions.csv, which may have no roll."""
    if 'qx' in known:
        return is_correct(quaternion, known_attitude(known))
    centre = unit_from_radec(*np.radians([float(known['ra_deg']), float(known['dec_deg'])]))
    off_rad = np.linalg.norm(matrix_from_quaternion(quaternion)[:, 2] - centre)
    return bool(np.degrees(off_rad) < CORRECT_BORESIGHT_DEG)


def real_rows(case: str, rich: bool, times_ms: np.ndarray, solved: np.ndarray, right: np.ndarray
              ) -> Iterator[PaperRow]:
    """
    Yield the rows of real_frames(), both modes compared with the paper's downlinked images.

    Where they are not rich, with fewer stars than those of the paper, its method is not bound.
    """
    count = len(times_ms)
    bound, first = ('both', 0) if rich else ('beyond', 1)
    good, bad = (list(map(int, each.sum(0))) for each in (right, solved & ~right))
    yield PaperRow(f'{case}: identified of {count}, initial mode', '100 of 100', good[0],
                   good[1], 'images', f'{bound} = {count}', min(good[first:2]) == count)
    yield PaperRow(f'{case}: wrong, initial mode', 0, bad[0], bad[1], 'images', f'{bound} = 0',
                   not any(bad[first:2]))
    yield PaperRow(f'{case}: identified of {count}, tracking mode', '100 of 100', None, good[2],
                   'images', f'= {count}', good[2] == count)
    yield PaperRow(f'{case}: wrong, tracking mode', 0, None, bad[2], 'images', '= 0', not bad[2])
    published_ms, initial_ms, tracked_ms = times_ms.mean(0)
    yield PaperRow(f'{case}: time, initial mode, mean', 89.9, published_ms, initial_ms, 'ms')
    yield PaperRow(f'{case}: time, tracking mode, mean', None, None, tracked_ms, 'ms',
                   f'<= initial, {initial_ms:.3g}', tracked_ms <= initial_ms)
    published_ms, initial_ms, tracked_ms = times_ms.max(0)
    yield PaperRow(f'{case}: time, initial mode, worst', 206.5, published_ms, initial_ms, 'ms')
    yield PaperRow(f'{case}: time, tracking mode, worst', None, None, tracked_ms, 'ms')
    for mode, column in (('initial', 1), ('tracking', 2)):
        yield PaperRow(f'{case}: output, {mode} mode', '11 Hz', None,
                       1e3 / times_ms[:, column].mean(), 'Hz')


def run_quad_campaign(*, trials: int, seed: int, scheduler: str = '',
                      output: Path | None = None) -> Result:
    """
    Identify trials frames along the orbit, and as many of the whole sky.

    With an output folder figure 5 is drawn there. Real images are those of REAL_IMAGES in the
    folder that STARTRACKER_DATA names.
    """
    along = joined(parallel_map(
        orbit_frames, [(_PART_TRIALS * i, *part) for i, part in enumerate(
            split_trials(trials, _PART_TRIALS, seed))], title='orbit', scheduler=scheduler))
    around, = parallel_trials(sky_frames, [()], trials, _PART_TRIALS, seed, title='whole sky',
                              scheduler=scheduler)
    rows = [*_database(), *_summary('orbit', along, True), *_summary('whole sky', around, False)]
    real = 'none: STARTRACKER_DATA names no folder with them'
    if 'STARTRACKER_DATA' in os.environ:
        for name, (epoch_year, rich) in REAL_IMAGES.items():
            rows += real_rows(f'real images, {name}', rich, *real_frames(
                Path(os.environ['STARTRACKER_DATA']) / name, epoch_year))
        real = ('photographs from the ground by two cameras, of 11.4 deg on one night and of '
                '6.1 deg with 50 ms, in place of the 100 downlinked images of the paper, which '
                'are not public. They look in several directions: in tracking mode the place '
                f'before is {_MOVED_DEG:g} deg off, as far as the image moves between two frames '
                'along the orbit. Those of 6.1 deg have 7 to 11 stars, the images of the paper '
                '13 to 18: its method is not bound there; two that nobody solved are left out')
    if output is not None:
        draw_angles(along, output)
    corner_deg = 2 * np.degrees(CAMERA.corner_angle_rad)
    return Result('campaign quad', rows, {
        'camera': f'{CAMERA.width} x {CAMERA.height} px, 20.3 deg from edge to edge, '
                  f'{corner_deg:.1f} deg from corner to corner',
        'orbit': f'that of ALOS, {ORBIT.altitude_km:g} km and {ORBIT.inclination_deg:g} deg, '
                 f'camera fixed to the zenith, frames {STEP_S:g} s apart, V 5.5, {SIGMA_PX:g} px '
                 "noise an axis; a stretch of sky as rich as the paper's images",
        'places': 'apparent: aberration by the velocity of the Earth and of the spacecraft, and '
                  f'deflection, {EPOCH_YEAR:g}',
        'whole sky': 'random attitudes, without figures in the paper',
        'as published': 'the first base quad that is one catalogue quad alone, the full field '
                        'matched by triangles with it, QUEST; not verified',
        'beyond': 'every quad verified by the whole field',
        'tracking mode': 'quads searched among the stars of the field that the frame before '
                         'predicts; the first frame of each fifty has none',
        'database': 'the paper removes doubles and variables; here close doubles are one star, '
                    'crowded stars are in no pair, and variables stay. The pairs of '
                    'the paper reach from corner to corner of a square of 20.3 deg; ours are '
                    'fewer by the square of the number of stars',
        'tolerance': f'{OPTIONS.tolerance_sigmas:g} sigma of the noise of a side, and '
                     f'{OPTIONS.fov_error_percent:g} % of it for the focal length: the 1e-6 of a '
                     'cosine in the paper is 1 arcsec at 10 deg, far below 0.5 px',
        'right': CORRECT_TEXT,
        'real images': real,
        'times': 'process CPU time of one thread after warm-up; the paper used MATLAB, so its '
                 'times bind nothing',
        'trials': trials, 'seed': seed}, ('ours',))


def draw_angles(frames: Frames, folder: Path) -> Path:
    """Draw the angles of QUEST along the orbit, and their errors: figure 5; return the picture."""
    figure = new_figure(figsize=(9, 3.6))
    angles, errors = figure.subplots(1, 2)
    good = np.isfinite(frames.error_rad).all(1)
    time_s = STEP_S * np.flatnonzero(good)
    quaternion = frames.quaternion[good]
    ra_rad, dec_rad = radec_from_unit(matrix_from_quaternion(quaternion)[..., 2])
    # With the boresight in common, the rotation between two attitudes is the roll.
    roll_rad = np.array([
        attitude_error(q, quaternion_from_pointing(float(ra), float(dec), 0.0))[2]
        for q, ra, dec in zip(quaternion, ra_rad, dec_rad)])
    for name, value in (('right ascension', ra_rad), ('declination', dec_rad),
                        ('roll', roll_rad)):
        angles.plot(time_s, np.degrees(np.unwrap(value)), label=name)
    angles.set(xlabel='time, s', ylabel='angle, deg')
    for column, name in enumerate(('about x', 'about y', 'roll')):
        errors.plot(time_s, frames.error_rad[good, column] / ARCSEC, linewidth=0.7, label=name)
    errors.set(xlabel='time, s', ylabel='error of QUEST, arcsec')
    for axis in (angles, errors):
        axis.grid(alpha=0.3)
        axis.legend()
    return save_picture(figure, folder / 'figure_5_angles.png')
