"""
Quad identification along an orbit and over the whole sky, beside the published figures.

Yuan, Zhang, Shi 2017: 300 consecutive simulated images.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.quad import QuadIdentifier
from startracker_ros.core.maths.rotation import random_attitude
from startracker_ros.evaluation.campaign.parallel import parallel_map, split_trials
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.tools.figures.correctness import CORRECT_TEXT, is_correct
from startracker_ros.tools.figures.timing import cpu_timed

EPOCH_YEAR = 2026.5
CAMERA = Camera.from_fov(1024, 1024, 20.3)
OPTIONS = IdentificationOptions(method='quad', magnitude_limit=5.5, max_image_stars=100)
SIGMA_PX = 0.5
STEP_S = 5.0

# Looks to the zenith from a sun-synchronous orbit. The quarter of a revolution was chosen for
# its stars, as many to an image as in the paper; that of the zenith is (ra_deg, dec_deg).
ORBIT = MotionOptions(motion='low_earth_orbit', inclination_deg=98.2, node_deg=240.0,
                      latitude_deg=190.0, ra_deg=58.5593533, dec_deg=-9.8967277)
_PART_TRIALS = 50
_WARM_UP = 5


@dataclass(frozen=True)
class Frame:
    """
    The result of one frame; stars counts those in the image.

    identified and misidentified count stars of the solution; triangles and false_triangles those
    of the paper's field match about the four brightest stars of the solution.
    """

    solved: bool
    wrong: bool
    stars: int
    identified: int
    misidentified: int
    triangles: int
    false_triangles: int
    time_ms: float


@cache
def _identifier() -> QuadIdentifier:
    return QuadIdentifier(CAMERA, EPOCH_YEAR, OPTIONS)


def orbit_frames(begin: int, count: int, seed: int) -> list[Frame]:
    """Return frames begin to begin + count along the orbit."""
    motion = motion_from_options(ORBIT)
    return _frames([motion.at(STEP_S * (begin + i)).q_icrf_from_sensor for i in range(count)],
                   np.random.default_rng(seed))


def sky_frames(count: int, seed: int) -> list[Frame]:
    """Return frames at random attitudes."""
    rng = np.random.default_rng(seed)
    return _frames([random_attitude(rng) for _ in range(count)], rng)


def _frames(attitudes: list[np.ndarray], rng: np.random.Generator) -> list[Frame]:
    warm = np.random.default_rng(0)
    for _ in range(_WARM_UP):
        _frame(random_attitude(warm), warm)
    return [_frame(q, rng) for q in attitudes]


def _frame(q: np.ndarray, rng: np.random.Generator) -> Frame:
    identifier = _identifier()
    centroids, hip = star_list(identifier.onboard, CAMERA, q, SIGMA_PX, rng)
    cpu_s, result = cpu_timed(identifier.identify, centroids)
    if result.attitude is None:
        return Frame(False, False, len(hip), 0, 0, 0, 0, 1e3 * cpu_s)
    field = identifier.field_stars(centroids)
    identified = result.hip[field.index]
    base = np.flatnonzero(identified)[:4]
    star = identifier.verifier.field_match(field.direction, field.sigma_rad, base,
                                           identifier.onboard.index_of(identified[base]))
    matched = np.where(star >= 0, identifier.onboard.hip[star], 0)
    return Frame(True, not is_correct(result.attitude.quaternion, q), len(hip),
                 *_correct_and_wrong(result.hip, hip),
                 *_correct_and_wrong(matched, hip[field.index]), 1e3 * cpu_s)


def _correct_and_wrong(identified: np.ndarray, hip: np.ndarray) -> tuple[int, int]:
    """Return the numbers of correctly and of wrongly identified stars."""
    return (int(np.count_nonzero((identified > 0) & (identified == hip))),
            int(np.count_nonzero((identified > 0) & (identified != hip))))


@dataclass(frozen=True)
class RatioRow:
    """A figure of ours beside that of the paper; ratio is ours over theirs."""

    case: str
    ours: float
    paper: float | None
    ratio: float | None
    unit: str
    bound: str
    holds: bool


def _row(case: str, ours: float, paper: float | None, unit: str, bound: str = '',
         holds: bool = True) -> RatioRow:
    return RatioRow(case, ours, paper, ours / paper if paper else None, unit, bound, holds)


def _database() -> Iterator[RatioRow]:
    pairs = _identifier().pairs
    for name, ours, paper in (('stars', len(pairs.star), 2827),
                              ('pairs', len(pairs.separation), 269421)):
        yield _row(f'database: {name}', ours, paper, name, '0.9 .. 1.1 of the paper',
                   0.9 <= ours / paper <= 1.1)


def _summary(case: str, frames: list[Frame], published: bool) -> Iterator[RatioRow]:
    """Yield the rows of one case; published when the paper has figures for it."""
    def paper(figure: float) -> float | None:
        return figure if published else None

    stars = [frame.stars for frame in frames]
    yield _row(f'{case}: stars in an image, fewest', min(stars), paper(14), 'stars')
    yield _row(f'{case}: stars in an image, most', max(stars), paper(23), 'stars')
    solved = 100 * float(np.mean([frame.solved and not frame.wrong for frame in frames]))
    # The paper has no poor fields, which need not all be solved.
    least = 100 if published else 99
    yield _row(f'{case}: identified', solved, paper(100), '%', f'>= {least}', solved >= least)
    wrong = sum(frame.wrong for frame in frames)
    yield _row(f'{case}: wrong', wrong, paper(0), 'frames', '= 0', wrong == 0)
    for name, right, false in (('answer', 'identified', 'misidentified'),
                               ('triangles', 'triangles', 'false_triangles')):
        share, wrong_share = (100 * sum(getattr(frame, field) for frame in frames) / sum(stars)
                              for field in (right, false))
        yield _row(f'{case}: stars identified by the {name}', share, None, '%', '>= 99',
                   share >= 99)
        yield _row(f'{case}: stars misnamed by the {name}', wrong_share, None, '%', '<= 0.1',
                   wrong_share <= 0.1)
    times_ms = [frame.time_ms for frame in frames]
    for name, ours, limit in (('mean', float(np.mean(times_ms)), 72.6),
                              ('worst', max(times_ms), 128.6)):
        yield _row(f'{case}: time, {name}', ours, paper(limit), 'ms', f'<= {limit}',
                   ours <= limit)


def run_quad_campaign(*, trials: int, seed: int, scheduler: str = '') -> Result:
    """Identify trials frames along the orbit, and as many of the whole sky."""
    parts = split_trials(trials, _PART_TRIALS, seed)
    along = parallel_map(orbit_frames,
                         [(_PART_TRIALS * i, *part) for i, part in enumerate(parts)],
                         title='orbit', scheduler=scheduler)
    around = parallel_map(sky_frames, parts, title='whole sky', scheduler=scheduler)
    rows = [*_database(), *_summary('orbit', sum(along, []), True),
            *_summary('whole sky', sum(around, []), False)]
    corner_deg = 2 * np.degrees(CAMERA.corner_angle_rad)
    return Result('campaign quad', rows, {
        'camera': f'{CAMERA.width} x {CAMERA.height} px, 20.3 deg from edge to edge, '
                  f'{corner_deg:.1f} deg from corner to corner',
        'orbit': f'700 km, camera fixed to the zenith, frames {STEP_S:g} s apart, V 5.5, '
                 f"{SIGMA_PX:g} px noise an axis; a stretch of sky as rich as the paper's images",
        'whole sky': 'random attitudes, without figures in the paper',
        'database': 'the paper removes doubles and variables; here close doubles are one star, '
                    'crowded stars are in no pair, and variables stay. The pairs of '
                    'the paper reach from corner to corner of a square of 20.3 deg; ours are '
                    'fewer by the square of the number of stars',
        'tolerance': f'{OPTIONS.tolerance_sigmas:g} sigma of the noise of a side, and '
                     f'{OPTIONS.fov_error_percent:g} % of it for the focal length: the 1e-6 of a '
                     'cosine in the paper is 1 arcsec at 10 deg, far below 0.5 px',
        'right': CORRECT_TEXT,
        'triangles': 'the field match of the paper about the four brightest stars of the solution',
        'times': 'process CPU time of one thread after warm-up; the paper used MATLAB',
        'trials': trials, 'seed': seed})
