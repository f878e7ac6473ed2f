"""
Extended grids in a narrow field over the whole sky, beside the published figures.

Qian, Sun, Cai, Huang: 10000 random directions a figure.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.extras import new_figure
from startracker_ros.evaluation.campaign.extended_grid_frames import (
    CATALOG_LIMIT, CATALOG_SIGMA_MAG, CATALOG_SIGMA_PX, Condition, DRIFT_DEG_H, frames,
    RANDOM_DEG_H, RATE_DEG_S, Tally)
from startracker_ros.evaluation.campaign.parallel import concatenated, parallel_trials
from startracker_ros.evaluation.campaign.picture import save_picture
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.rows import CampaignRow

_PART_TRIALS = 500
_PAPER_PERCENT = {0.35: (98.2, '98.2'), 1.0: (97.4, '> 97.4')}
"""Success of the paper by position noise in px: the bound of ours, and as printed."""

POSITIONS = [Condition(position_px=noise) for noise in (0.0, 0.2, 0.35, 0.5, 0.75, 1.0)]
MAGNITUDES = [Condition(position_px=0.3, magnitude_sigma=noise)
              for noise in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)]
PERIODS = [Condition(period_s=period) for period in (2.0, 5.0, 10.0)]
BASE = Condition()
PERFECT = Condition(position_px=0.0, magnitude_sigma=0.0, perfect=True)
# With Hipparcos to this limit as many frames hold 6 stars, and fewer than 2, as in the paper.
SPARSE = [Condition(position_px=noise, magnitude_limit=7.4) for noise in (0.35, 1.0)]


def run_extended_grid_campaign(*, trials: int, seed: int, scheduler: str = '',
                               output: Path | None = None) -> Result:
    """Run every condition; with an output folder the two curves are drawn there."""
    conditions = list(dict.fromkeys([PERFECT, *POSITIONS, *MAGNITUDES, *PERIODS, *SPARSE]))
    done = parallel_trials(frames, [(condition,) for condition in conditions], trials,
                           _PART_TRIALS, seed, title='extended grid', scheduler=scheduler)
    tally = {condition: concatenated(parts) for condition, parts in zip(conditions, done)}
    if output is not None:
        draw_curves(tally, output)
    return Result('campaign extended-grid', list(rows(tally)), {
        'sensor': '4 x 4 deg, 1024 px, stars measured at V <= 7.5, no false stars; extended field '
                  '8 x 8 deg, cell 0.2 deg, g = 40, buffer radius 0.3 deg',
        'catalogue': f'Hipparcos, {len(load_catalog().brighter_than(CATALOG_LIMIT))} stars to '
                     f'V {CATALOG_LIMIT:g} (the paper has 42057 of Tycho-2), noise '
                     f'{CATALOG_SIGMA_PX:g} px and {CATALOG_SIGMA_MAG:g} mag',
        'gyro': f'turn of {RATE_DEG_S:g} deg/s about any axis; drift {DRIFT_DEG_H:g} deg/h on '
                f'each axis and {RANDOM_DEG_H:g} deg/h of noise in each measurement, one a second',
        'focal length': 'known to 0.5 %, and fitted',
        'attitude before': 'with the covariance of two stars 2 deg apart under the same noise',
        'success': 'at least two stars identified and none wrongly; a frame of fewer stars fails',
        'noise not named in a row': '0.35 px, 0.2 mag, period 1 s',
        'triangles': 'a star and its two nearest neighbours outside the buffer radius in the '
                     'combined image, three sides within 3.5 sigma of their known noise, '
                     'not verified',
        'grid alone': "identified by the patterns, not verified: the paper's method",
        'nearest neighbour': 'of each star in image A: the same star in C (extended) or '
                             'among the observed ones (plain) as in A',
        'time': 'process CPU time of identify, median',
        'trials': trials, 'seed': seed})


def _at_least(case: str, ours: float, least: float, paper: str) -> CampaignRow:
    return CampaignRow(case, ours, paper, '%', f'>= {least:g}', ours >= least)


def _above_triangles(case: str, tally: Tally, method: str) -> CampaignRow:
    """Return the success of a method, which has to be above that of triangles."""
    ours, other = tally.percent(method), tally.percent('triangle_solved')
    return CampaignRow(case, ours, 'curve', '%', f'> triangles, {other:.2f}', ours > other)


def _star_count_rows(cases: tuple[str, str], stars: np.ndarray) -> Iterator[CampaignRow]:
    """Yield the shares of frames of fewer than 2 stars, and of 6 stars or more."""
    for case, share, paper in zip(cases, (stars < 2, stars >= 6), ('0.6', '79.71')):
        yield CampaignRow(case, 100 * float(np.mean(share)), paper, '%')


def rows(tally: dict[Condition, Tally]) -> Iterator[CampaignRow]:
    """Yield the table."""
    yield from _star_count_rows(('frames of fewer than 2 stars', 'frames of 6 stars or more'),
                                tally[PERFECT].stars)
    yield from _success_rows(tally)
    yield from _sparse_rows(tally)
    for condition in (BASE, POSITIONS[-1], MAGNITUDES[-1]):
        yield _above_triangles(
            f'grid alone, {condition.position_px:g} px, {condition.magnitude_sigma:g} mag: '
            'success', tally[condition], 'grid_solved')
    for conditions, what in ((POSITIONS, '0 .. 1 px'), (MAGNITUDES, '0 .. 0.5 mag')):
        ours, other = (tally[conditions[0]].percent(name) - tally[conditions[-1]].percent(name)
                       for name in ('solved', 'triangle_solved'))
        yield CampaignRow(f'success lost from noise of {what}', ours, 'curve', '%',
                          f'< triangles, {other:.2f}', ours < other)
    yield from _neighbour_rows(tally[BASE])
    wrong = sum(int(one.wrong.sum()) for one in tally.values())
    total = sum(len(one.wrong) for one in tally.values())
    yield CampaignRow(f'frames with a wrong star, of all {total}', wrong, '', 'frames', '= 0',
                      wrong == 0)
    time_ms = float(np.median(tally[BASE].time_ms))
    yield CampaignRow('time of a frame, median', time_ms, '6', 'ms', '<= 6', time_ms <= 6)


def _success_rows(tally: dict[Condition, Tally]) -> Iterator[CampaignRow]:
    """Yield the success without noise, over both kinds of noise and over the period."""
    yield _at_least('success without any noise', tally[PERFECT].percent('solved'), 99.4, '99.4')
    for condition in POSITIONS:
        least, paper = _PAPER_PERCENT.get(condition.position_px, (97.4, '> 97.4'))
        yield _at_least(f'success, position noise {condition.position_px:g} px',
                        tally[condition].percent('solved'), least, paper)
    for condition in MAGNITUDES:
        yield _above_triangles(
            f'success, magnitude noise {condition.magnitude_sigma:g} mag, 0.3 px',
            tally[condition], 'solved')
    for condition in PERIODS:
        yield _at_least(f'success, update period {condition.period_s:g} s',
                        tally[condition].percent('solved'), 97.6,
                        '97.6' if condition.period_s == 10 else '>= 97.6')


def _sparse_rows(tally: dict[Condition, Tally]) -> Iterator[CampaignRow]:
    """Yield the rows with as few stars as in the paper."""
    limit = f'V <= {SPARSE[0].magnitude_limit:g}'
    yield from _star_count_rows(
        (f'{limit}, as few stars as in the paper: fewer than 2', 'the same: 6 stars or more'),
        tally[SPARSE[0]].stars)
    for condition in SPARSE:
        yield _at_least(f'the same: success at {condition.position_px:g} px',
                        tally[condition].percent('solved'), *_PAPER_PERCENT[condition.position_px])


def _neighbour_rows(tally: Tally) -> Iterator[CampaignRow]:
    extended, plain = (100 * float(count.sum() / tally.neighbours.sum())
                       for count in (tally.extended_right, tally.plain_right))
    yield _at_least('nearest neighbour right, extended image', extended, 86.7, '86.7')
    yield CampaignRow('nearest neighbour right, plain image', plain, '52.2', '%', '< extended',
                      plain < extended)


def draw_curves(tally: dict[Condition, Tally], folder: Path) -> Path:
    """Draw success over position and over magnitude noise; return the picture."""
    figure = new_figure(figsize=(10, 4))
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
    return save_picture(figure, folder / 'extended_grid.png')
