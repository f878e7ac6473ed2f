# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Is a clear field ever left unidentified? Close pairs resolved in any way, and many false spots.

The star lists are made from all stars of the catalogue, not from the on-board catalogue: which
of two close stars a detector resolves, joins or misses is known to the model of a case only.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import cKDTree
from startracker_evaluation.bench.corpus import EPOCH_YEAR, View
from startracker_evaluation.bench.narrow_field import NARROW_CONDITIONS, narrow_field_rows
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions, Identifier
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import random_attitude
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.correctness import CORRECT_TEXT, is_correct
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.figures.timing import cpu_timed
from startracker_ros.tools.parallel import parallel_trials

VIEWS = {view.name: view for view in (
    View('A12', 512, 12.0, 6.0), View('C10', 1024, 10.0, 6.5), View('D12', 1024, 12.0, 6.5))}
# Standard deviations of the centroids, one for each frame.
_SIGMA_PX = (0.05, 0.2)
_MIN_STARS = 6
# Fields of 35 stars on average, for the false spots, and one frame of them for ten of the others.
_SPOT_STARS = (30, 40)
_SPOT_VIEW = 'D12'
_SPOT_SHARE = 10
_PART_TRIALS = 500


@dataclass(frozen=True)
class Case:
    """
    How stars are imaged.

    Of stars within join_px of a brighter one, the light is joined at the photocentre, or lost if
    drop is set. false is the number of false spots. Their fluxes are those of random stars of the
    field, or, if bright is set, uniform from its faintest to its brightest star, so that nearly
    all spots are brighter than nearly all stars.
    """

    join_px: float = 0.0
    drop: bool = False
    false: int = 0
    bright: bool = False


CASES = {
    'resolved': Case(),
    **{f'joined within {px:g} px': Case(px) for px in (1.0, 2.0, 2.5, 4.0)},
    **{f'fainter dropped within {px:g} px': Case(px, drop=True) for px in (2.0, 4.0)},
    '100 false spots': Case(2.0, false=100),
    '100 bright false spots': Case(2.0, false=100, bright=True),
    '300 false spots': Case(2.0, false=300),
    '300 bright false spots': Case(2.0, false=300, bright=True),
}

NARROW = 'narrow fields'
ALL_CASES = (*CASES, NARROW)


@dataclass(frozen=True)
class Outcome:
    """Whether frames (N,) were solved, and correctly, and the CPU time (N,) in s of each."""

    solved: np.ndarray
    correct: np.ndarray
    cpu_s: np.ndarray


@cache
def imaged_sky(view: View, case: Case) -> OnboardCatalog:
    """Return the stars that a camera detects where close ones blend as in a case."""
    catalog = load_catalog()
    direction = catalog.directions(EPOCH_YEAR)
    flux = 10 ** (-0.4 * catalog.magnitude.astype(float))
    chord = 2 * np.sin(case.join_px * view.camera.pixel_rad / 2)
    pairs = cKDTree(direction).query_pairs(chord, output_type='ndarray')
    pairs = np.sort(pairs, axis=1)
    single = np.ones(len(catalog), bool)
    total, centre = flux.copy(), direction * flux[:, None]
    # The stars are in order of magnitude: each joins the first that is left near it.
    for bright, faint in pairs[np.lexsort(pairs.T)]:
        if single[bright] and single[faint]:
            single[faint] = False
            if not case.drop:
                total[bright] += flux[faint]
                centre[bright] += flux[faint] * direction[faint]
    magnitude = -2.5 * np.log10(total)
    seen = np.flatnonzero(single & (magnitude <= view.magnitude_limit))
    seen = seen[np.argsort(magnitude[seen], kind='stable')]
    unit = centre[seen] / np.linalg.norm(centre[seen], axis=1, keepdims=True)
    unmarked = np.zeros(len(seen), bool)
    return OnboardCatalog(catalog.hip[seen], unit, magnitude[seen], unmarked, unmarked)


@cache
def _identifier(view: View) -> Identifier:
    return make_identifier(view.camera, EPOCH_YEAR,
                           IdentificationOptions(magnitude_limit=view.magnitude_limit))


def solve_frames(view: View, case: Case, trials: int, seed: int) -> Outcome:
    """Identify frames at random attitudes."""
    rng = np.random.default_rng(seed)
    identifier = _identifier(view)
    identifier.identify(frame(view, case, np.random.default_rng(seed))[0])
    solved, correct, cpu_s = np.zeros(trials, bool), np.zeros(trials, bool), np.zeros(trials)
    for trial in range(trials):
        centroids, q = frame(view, case, rng)
        cpu_s[trial], result = cpu_timed(identifier.identify, centroids)
        if result.attitude is not None:
            solved[trial] = True
            correct[trial] = is_correct(result.attitude.quaternion, q)
    return Outcome(solved, correct, cpu_s)


def frame(view: View, case: Case, rng: np.random.Generator) -> tuple[Centroids, np.ndarray]:
    """Return centroids in random order and their q_icrf_from_sensor (4,)."""
    least, most = _SPOT_STARS if case.false else (_MIN_STARS, np.inf)
    sky, sigma_px = imaged_sky(view, case), rng.uniform(*_SIGMA_PX)
    while True:
        q = random_attitude(rng)
        seen, _ = star_list(sky, view.camera, q, sigma_px, rng)
        if least <= len(seen) <= most:
            break
    spots = rng.uniform(-0.5, [view.width - 0.5, view.width - 0.5], (case.false, 2))
    flux = (rng.uniform(seen.flux.min(), seen.flux.max(), case.false) if case.bright
            else rng.choice(seen.flux, case.false))
    count = len(seen) + case.false
    mixed = Centroids(np.concatenate([seen.uv, spots]),
                      np.concatenate([seen.flux, flux]),
                      np.full(count, seen.snr[0]), np.full(count, sigma_px))
    return mixed.select(rng.permutation(count)), q


def run_identification_bench(*, trials: int, seed: int, only: Sequence[str] = (),
                             scheduler: str = '') -> Result:
    """Identify trials frames of each camera and case, a tenth with false spots or narrow."""
    rows: list[Row] = []
    names = [name for name in only or ALL_CASES if name in CASES]
    pairs = [(name, view) for name in names if not CASES[name].false for view in VIEWS.values()]
    spots = [(name, VIEWS[_SPOT_VIEW]) for name in names if CASES[name].false]
    spot_trials = max(trials // _SPOT_SHARE, 1)
    for cells, count, title in ((pairs, trials, 'close pairs'),
                                (spots, spot_trials, 'false spots')):
        cases = [(view, CASES[name]) for name, view in cells]
        done = parallel_trials(solve_frames, cases, count, _PART_TRIALS, seed, title=title,
                               scheduler=scheduler)
        for (name, view), outcome in zip(cells, done):
            rows += _rows(f'{view.name}, {name}', CASES[name], outcome)
    if NARROW in (only or ALL_CASES):
        rows += narrow_field_rows(trials=spot_trials, seed=seed, scheduler=scheduler)
    return Result('bench identification', rows, {
        'cameras': '; '.join(f'{view.name}: {view.fov_deg:g} deg, {view.width} px, V '
                             f'{view.magnitude_limit:g}' for view in VIEWS.values()),
        'frames': f'random attitudes with {_MIN_STARS} stars or more, or {_SPOT_STARS[0]} to '
                  f'{_SPOT_STARS[1]} with false spots; a noise of {_SIGMA_PX[0]:g} to '
                  f'{_SIGMA_PX[1]:g} px; default options, magnitude limit of the camera',
        'stars': 'all of the catalogue, blended by the case alone; with false spots joined within '
                 '2 px',
        'false spots': 'uniform over the image, fluxes of random stars of the field; bright: '
                       'uniform from its faintest to its brightest star',
        'wrong': f'not {CORRECT_TEXT}',
        'times': 'process CPU time of a frame',
        NARROW: NARROW_CONDITIONS,
        'trials': trials, 'seed': seed})


def _rows(name: str, case: Case, outcome: Outcome) -> Iterator[Row]:
    """Yield the figures of a camera and a case."""
    unsolved = int(np.count_nonzero(~outcome.solved))
    wrong = int(np.count_nonzero(outcome.solved & ~outcome.correct))
    if case.false:
        solved = 100 * float(np.mean(outcome.solved))
        # More spots need the whole time limit of some frames: as many as the machine has time for.
        yield Row(f'{name}: solved', solved, '%', least=95 if case.false <= 100 else None)
        median_ms = 1e3 * float(np.median(outcome.cpu_s))
        yield Row(f'{name}: time, median', median_ms, 'ms', most=1000)
    else:
        yield Row(f'{name}: unsolved', unsolved, 'frames', exactly=0)
    yield Row(f'{name}: wrong', wrong, 'frames', exactly=0)
