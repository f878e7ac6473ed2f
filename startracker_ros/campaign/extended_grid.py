"""
Extended grids in a narrow field over the whole sky, beside the published figures.

Qian, Sun, Cai, Huang: 10000 random directions a figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
import time

import numpy as np
from startracker_ros.attitude.estimate import cramer_rao
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.attitude.propagate import AttitudePrediction, AttitudePropagator
from startracker_ros.camera.model import Camera
from startracker_ros.campaign.parallel import split, spread
from startracker_ros.catalog.onboard import camera_places, StarPlaces
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.identify.extended_grid import ExtendedGridIdentifier, PredictedField
from startracker_ros.identify.identification import IdentificationOptions
from startracker_ros.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.sky.star_lists import random_attitude, star_list
from startracker_ros.table import Result

EPOCH_YEAR = 2026.5
CAMERA = Camera.from_fov(1024, 1024, 4.0)
CATALOG_LIMIT = 8.0
CATALOG_SIGMA_PX = 0.1
CATALOG_SIGMA_MAG = 0.1
DRIFT_DEG_H = 1.0
RANDOM_DEG_H = 0.5
GYRO_PERIOD_S = 1.0
RATE_DEG_S = 0.06
# The attitude before is known as from the fewest stars that count as a success, so far apart.
_EARLIER_STARS_PX = np.array([[255.5, 511.5], [767.5, 511.5]])
# A triangle fits within so many sigmas of its noise, as a star does.
_TRIANGLE_SIGMAS = 3.5
_DEG_H = np.radians(1 / 3600)
_PIECE = 500

Row = dict[str, object]


@dataclass(frozen=True)
class Condition:
    """What the frames of one figure suffer from; perfect leaves out every other noise too."""

    position_px: float = 0.35
    magnitude_sigma: float = 0.2
    period_s: float = 1.0
    magnitude_limit: float = 7.5
    perfect: bool = False


POSITIONS = [Condition(position_px=noise) for noise in (0.0, 0.2, 0.35, 0.5, 0.75, 1.0)]
MAGNITUDES = [Condition(position_px=0.3, magnitude_sigma=noise)
              for noise in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)]
PERIODS = [Condition(period_s=period) for period in (2.0, 5.0, 10.0)]
BASE = Condition()
PERFECT = Condition(position_px=0.0, magnitude_sigma=0.0, perfect=True)
# With Hipparcos to this limit as many frames hold 6 stars, and fewer than 2, as in the paper.
SPARSE = [Condition(position_px=noise, magnitude_limit=7.4) for noise in (0.35, 1.0)]


@dataclass(frozen=True)
class Tally:
    """
    What became of frames, each array one figure a frame.

    stars (F,) were seen; solved, wrong, grid_solved, grid_wrong, triangle_solved and
    triangle_wrong (F,) bool say whether at least two stars were named and all of them rightly, and
    whether any was misnamed: by the method, by its grid alone, by triangles.
    neighbours, extended_right and plain_right (F,) count stars whose nearest neighbour the
    catalogue knows, and for how many the combined and the plain image have the same one.
    """

    stars: np.ndarray
    solved: np.ndarray
    wrong: np.ndarray
    grid_solved: np.ndarray
    grid_wrong: np.ndarray
    triangle_solved: np.ndarray
    triangle_wrong: np.ndarray
    neighbours: np.ndarray
    extended_right: np.ndarray
    plain_right: np.ndarray
    time_ms: np.ndarray

    def percent(self, name: str) -> float:
        """Return the share of the frames in %."""
        return 100 * float(np.mean(getattr(self, name)))


@cache
def _sky() -> StarPlaces:
    return camera_places(load_catalog(), CAMERA, EPOCH_YEAR)


@cache
def _identifier(perfect: bool) -> ExtendedGridIdentifier:
    """Return an identifier whose catalogue has the paper's noise, the same in every process."""
    identifier = ExtendedGridIdentifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
        method='extended_grid', magnitude_limit=CATALOG_LIMIT))
    if not perfect:
        rng = np.random.default_rng(0)
        places = identifier.places
        # Noise along the line of sight does nothing.
        direction = places.direction + rng.normal(
            0, CATALOG_SIGMA_PX * CAMERA.pixel_rad, places.direction.shape)
        magnitude = places.magnitude + rng.normal(0, CATALOG_SIGMA_MAG, len(places))
        order = np.argsort(magnitude)
        identifier.places = StarPlaces(
            places.hip[order],
            (direction / np.linalg.norm(direction, axis=1, keepdims=True))[order],
            magnitude[order], places.crowded[order])
    return identifier


def predicted(q: np.ndarray, condition: Condition, rng: np.random.Generator
              ) -> tuple[np.ndarray, AttitudePrediction]:
    """Return the attitude a period after q (4,), and what the gyro says that it is."""
    axis = rng.standard_normal(3)
    rate = np.radians(RATE_DEG_S) * axis / np.linalg.norm(axis)
    truth = multiply(q, quaternion_from_rotation_vector(rate * condition.period_s))
    if condition.perfect:
        return truth, AttitudePrediction(truth, np.zeros((3, 3)))
    sigma_px = np.hypot(condition.position_px, CATALOG_SIGMA_PX)
    covariance = cramer_rao(CAMERA.unproject(_EARLIER_STARS_PX),
                            np.full(2, sigma_px * CAMERA.pixel_rad))
    error = rng.multivariate_normal(np.zeros(3), covariance)
    propagator = AttitudePropagator(GyroErrorOptions(
        gyro_drift_deg_h=DRIFT_DEG_H, gyro_rate_change_deg_s2=0.0,
        # Noise of so many deg/h over a period in s is so many deg over the root of an hour.
        gyro_noise_deg_sqrt_h=RANDOM_DEG_H * np.sqrt(GYRO_PERIOD_S / 3600)))
    propagator.start(0, multiply(q, quaternion_from_rotation_vector(error)), covariance)
    drift = DRIFT_DEG_H * _DEG_H * rng.choice([-1, 1], 3)
    for k in range(round(condition.period_s / GYRO_PERIOD_S)):
        propagator.add_rate(round((k + 1) * GYRO_PERIOD_S * 1e9),
                            rate + drift + rng.normal(0, RANDOM_DEG_H * _DEG_H, 3))
    prediction = propagator.predict(round(condition.period_s * 1e9))
    assert prediction is not None, 'it has rates up to the end of the period'
    return truth, prediction


def frames(condition: Condition, trials: int, seed: int) -> Tally:
    """Return what became of frames; a seed has the same directions under every condition."""
    identifier = _identifier(condition.perfect)
    rows = [_frame(identifier, condition, np.random.default_rng((seed, trial)))
            for trial in range(trials)]
    return Tally(*(np.array(column) for column in zip(*rows)))


def _frame(identifier: ExtendedGridIdentifier, condition: Condition,
           rng: np.random.Generator) -> tuple:
    """Return one row of the tally."""
    q, prior = predicted(random_attitude(rng), condition, rng)
    centroids, hip = star_list(_sky(), CAMERA, q, condition.position_px, rng,
                               magnitude_sigma=condition.magnitude_sigma)
    seen = centroids.flux >= 1e6 * 10 ** (-0.4 * condition.magnitude_limit)
    centroids, hip = centroids.select(seen), hip[seen]
    begin_s = time.process_time()
    result = identifier.identify(centroids, prior)
    time_ms = (time.process_time() - begin_s) * 1e3

    field = identifier.field_stars(centroids)
    hip_seen = hip[field.index]
    observed = field.direction[:, :2] / field.direction[:, 2:]
    image = identifier.predicted_field(prior.quaternion)
    hip_known = identifier.places.hip[image.star]
    votes = identifier.recognise(observed, image)
    sigma = np.hypot(condition.position_px, CATALOG_SIGMA_PX) * CAMERA.pixel_rad
    fits = triangle_votes(observed, image.brightest(len(observed)), identifier.buffer_rad, sigma)
    return (len(centroids), *_verdict(result.hip, hip),
            *_verdict(np.where(votes >= 0, hip_known[votes], 0), hip_seen),
            *_verdict(np.where(fits >= 0, hip_known[fits], 0), hip_seen),
            *_neighbours(identifier, observed, hip_seen, image, hip_known), time_ms)


def _verdict(named: np.ndarray, hip: np.ndarray) -> tuple[bool, bool]:
    """Return whether two stars or more are named and none wrongly, and whether any is."""
    wrong = bool(np.any((named > 0) & (named != hip)))
    return bool(np.count_nonzero(named) >= 2 and not wrong), wrong


def _neighbours(identifier: ExtendedGridIdentifier, observed: np.ndarray, hip: np.ndarray,
                image: PredictedField, hip_known: np.ndarray) -> tuple[int, int, int]:
    """Return of how many stars the neighbour is known, and in how many images it is right."""
    image = image.brightest(len(observed))
    hip_known = hip_known[:len(image.star)]
    star, row = np.nonzero(hip[:, None] == hip_known)
    if not len(star):
        return 0, 0, 0
    right = hip_known[identifier.patterns(image.tangent, row)[1]]
    combined = np.concatenate([observed, image.tangent[~image.inside]])
    hip_combined = np.concatenate([hip, hip_known[~image.inside]])
    extended = hip_combined[identifier.patterns(combined, star)[1]]
    plain = hip[identifier.patterns(observed, star)[1]]
    return (len(star), int(np.count_nonzero(extended == right)),
            int(np.count_nonzero(plain == right)))


def triangle_votes(observed: np.ndarray, image: PredictedField, buffer_rad: float,
                   sigma_rad: float) -> np.ndarray:
    """
    Return for each observed place (N, 2) the row of the predicted star, -1 for none.

    The extended-image triangle method: a star and its two nearest neighbours outside the
    buffer radius, in the combined image, against the triangles of the catalogue stars. The
    three sides have to agree within their noise, which is known, with one star only.
    """
    known = np.flatnonzero(image.inside)
    combined = np.concatenate([observed, image.tangent[~image.inside]])
    seen = _triangles(combined, np.arange(len(observed)), buffer_rad)
    there = _triangles(image.tangent, known, buffer_rad)
    tolerance = _TRIANGLE_SIGMAS * np.sqrt(2) * sigma_rad
    fits = (np.abs(seen[:, None] - there) <= tolerance).all(2)
    if not len(known):
        return np.full(len(observed), -1)
    return np.where(fits.sum(1) == 1, known[fits.argmax(1)], -1)


def _triangles(place: np.ndarray, reference: np.ndarray, buffer_rad: float) -> np.ndarray:
    """Return the sides (K, 3) of reference stars (K,); NaN without two neighbours."""
    if len(place) < 3:
        return np.full((len(reference), 3), np.nan)
    away = place - place[reference][:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    distance = np.where(distance > buffer_rad, distance, np.inf)
    near = np.argsort(distance, axis=1)[:, :2]
    sides = np.take_along_axis(distance, near, 1)
    opposite = np.linalg.norm(place[near[:, 0]] - place[near[:, 1]], axis=1)
    complete = np.isfinite(sides).all(1)[:, None]
    return np.where(complete, np.column_stack([sides, opposite]), np.nan)


def run_extended_grid_campaign(*, trials: int, seed: int, scheduler: str = '',
                               output: Path | None = None) -> Result:
    """Run every condition; with an output folder the two curves are drawn there."""
    conditions = list(dict.fromkeys([PERFECT, *POSITIONS, *MAGNITUDES, *PERIODS, *SPARSE]))
    pieces = split(trials, _PIECE, seed)
    done = spread(frames, [(condition, *piece) for condition in conditions for piece in pieces],
                  title='extended grid', scheduler=scheduler)
    tally = {condition: _joined(done[k * len(pieces):(k + 1) * len(pieces)])
             for k, condition in enumerate(conditions)}
    if output is not None:
        draw_curves(tally, output)
    return Result('campaign extended-grid', rows(tally), {
        'sensor': '4 x 4 deg, 1024 px, stars measured at V <= 7.5, no false stars; extended field '
                  '8 x 8 deg, cell 0.2 deg, g = 40, buffer radius 0.3 deg',
        'catalogue': f'Hipparcos, {len(load_catalog().brighter_than(CATALOG_LIMIT))} stars to '
                     f'V {CATALOG_LIMIT:g} (the paper has 42057 of Tycho-2), noise '
                     f'{CATALOG_SIGMA_PX:g} px and {CATALOG_SIGMA_MAG:g} mag',
        'gyro': f'turn of {RATE_DEG_S:g} deg/s about any axis; drift {DRIFT_DEG_H:g} deg/h on '
                f'each axis and {RANDOM_DEG_H:g} deg/h of noise in each measurement, one a second',
        'focal length': 'taken as known to 0.5 %, and fitted',
        'attitude before': 'known as two stars 2 deg apart give it under the same noise',
        'success': 'at least two stars named and none wrongly; a frame of fewer stars fails',
        'noise not named in a row': '0.35 px, 0.2 mag, period 1 s',
        'triangles': 'a star and its two nearest neighbours outside the buffer radius in the '
                     'combined image, three sides within 3.5 sigma of noise that is known, '
                     'not verified',
        'grid alone': "what the patterns recognise, not verified: the paper's method",
        'nearest neighbour': 'of each star that image A holds: the same star in C (extended) or '
                             'among the observed ones (plain) as in A',
        'time': 'process CPU time of identify, median',
        'trials': trials, 'seed': seed})


def _joined(parts: Sequence[Tally]) -> Tally:
    return Tally(*(np.concatenate([getattr(part, column.name) for part in parts])
                   for column in fields(Tally)))


def _row(case: str, ours: float, paper: str, unit: str, bound: str, holds: bool) -> Row:
    return {'case': case, 'ours': ours, 'paper': paper, 'unit': unit, 'bound': bound,
            'holds': bool(holds)}


def _at_least(case: str, ours: float, least: float, paper: str) -> Row:
    return _row(case, ours, paper, '%', f'>= {least:g}', ours >= least)


def rows(tally: dict[Condition, Tally]) -> list[Row]:
    """Return the table."""
    base, perfect = tally[BASE], tally[PERFECT]
    few, six = (100 * float(np.mean(share)) for share in (perfect.stars < 2, perfect.stars >= 6))
    sparse = tally[SPARSE[0]].stars
    table = [
        _row('frames of fewer than 2 stars', few, '0.6', '%', '', True),
        _row('frames of 6 stars or more', six, '79.71', '%', '', True),
        _at_least('success without any noise', perfect.percent('solved'), 99.4, '99.4')]
    papers = {0.35: (98.2, '98.2'), 1.0: (97.4, '> 97.4')}
    for condition in POSITIONS:
        least, paper = papers.get(condition.position_px, (97.4, '> 97.4'))
        table.append(_at_least(f'success, position noise {condition.position_px:g} px',
                               tally[condition].percent('solved'), least, paper))
    for condition in MAGNITUDES:
        ours, other = (tally[condition].percent(name) for name in ('solved', 'triangle_solved'))
        table.append(_row(
            f'success, magnitude noise {condition.magnitude_sigma:g} mag, 0.3 px', ours, 'curve',
            '%', f'> triangles, {other:.2f}', ours > other))
    for condition in PERIODS:
        least, paper = (97.6, '97.6') if condition.period_s == 10 else (97.6, '>= 97.6')
        table.append(_at_least(f'success, update period {condition.period_s:g} s',
                               tally[condition].percent('solved'), least, paper))
    table += [
        _row(f'V <= {SPARSE[0].magnitude_limit:g}, as few stars as in the paper: fewer than 2',
             100 * float(np.mean(sparse < 2)), '0.6', '%', '', True),
        _row('the same: 6 stars or more', 100 * float(np.mean(sparse >= 6)), '79.71', '%', '',
             True)]
    for condition, (least, paper) in zip(SPARSE, papers.values()):
        table.append(_at_least(f'the same: success at {condition.position_px:g} px',
                               tally[condition].percent('solved'), least, paper))
    for condition in (BASE, POSITIONS[-1], MAGNITUDES[-1]):
        alone, other = (tally[condition].percent(name)
                        for name in ('grid_solved', 'triangle_solved'))
        table.append(_row(
            f'grid alone, {condition.position_px:g} px, {condition.magnitude_sigma:g} mag: '
            'success', alone, 'curve', '%', f'> triangles, {other:.2f}', alone > other))
    for conditions, what in ((POSITIONS, '0 .. 1 px'), (MAGNITUDES, '0 .. 0.5 mag')):
        ours, other = (tally[conditions[0]].percent(name) - tally[conditions[-1]].percent(name)
                       for name in ('solved', 'triangle_solved'))
        table.append(_row(f'success lost from noise of {what}', ours, 'curve', '%',
                          f'< triangles, {other:.2f}', ours < other))
    neighbours = base.neighbours.sum()
    extended, plain = (100 * float(count.sum() / neighbours)
                       for count in (base.extended_right, base.plain_right))
    wrong = sum(int(one.wrong.sum()) for one in tally.values())
    total = sum(len(one.wrong) for one in tally.values())
    time_ms = float(np.median(base.time_ms))
    return table + [
        _at_least('nearest neighbour right, extended image', extended, 86.7, '86.7'),
        _row('nearest neighbour right, plain image', plain, '52.2', '%',
             '< extended', plain < extended),
        _row(f'frames with a wrong star, of all {total}', wrong, '', 'frames', '= 0', wrong == 0),
        _row('time of a frame, median', time_ms, '6', 'ms', '<= 6', time_ms <= 6)]


def draw_curves(tally: dict[Condition, Tally], folder: Path) -> Path:
    """Draw success over position and over magnitude noise; return the picture."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(10, 4), layout='constrained')
    axes = figure.subplots(1, 2, sharey=True)
    for axis, conditions, name, label in (
            (axes[0], POSITIONS, 'position_px', 'position noise, px (0.2 mag)'),
            (axes[1], MAGNITUDES, 'magnitude_sigma', 'magnitude noise, mag (0.3 px)')):
        noise = [getattr(condition, name) for condition in conditions]
        for column, legend, style in (
                ('solved', 'extended grid, verified', 'o-'),
                ('grid_solved', 'extended grid alone', 's--'),
                ('triangle_solved', 'extended-image triangles', '^:')):
            axis.plot(noise, [tally[condition].percent(column) for condition in conditions],
                      style, label=legend)
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel('success, %')
    axes[0].legend()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'extended_grid.png'
    figure.savefig(path, dpi=120)
    return path
