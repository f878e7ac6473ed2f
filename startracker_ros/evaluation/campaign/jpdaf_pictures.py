# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of the JPDAF paper: paths of the stars, errors of attitude and position."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from startracker_ros.core.extras import new_figure
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.evaluation.campaign.jpdaf_methods import Estimate
from startracker_ros.evaluation.campaign.jpdaf_runs import Cell, DT_S, FRAMES, Run, STARS
from startracker_ros.evaluation.campaign.picture import save_picture

Estimates = Sequence[Mapping[str, Estimate]]


def draw_errors(found: Mapping[Cell, Mapping[str, np.ndarray]], folder: Path) -> Path:
    """Draw errors (F,) over the frames, mean of all runs, by method, at 0.02 px^2."""
    figure = new_figure(figsize=(12, 6))
    cells = [cell for cell in found if cell.variance_px2 == 0.02]
    for axis, cell in zip(figure.subplots(2, len(cells) // 2, sharex=True, sharey=True).flat,
                          cells):
        # It covers another one.
        *_, last = found[cell]
        for method, error in found[cell].items():
            axis.plot(np.arange(FRAMES), error, '--' if method == last else '-', linewidth=1,
                      label=method)
        axis.set_title(str(cell))
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    figure.supxlabel('frame')
    figure.supylabel('boresight error, arcsec')
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc='outside upper center',
                  ncols=len(found[cells[0]]))
    return save_picture(figure, folder / 'jpdaf.png')


def draw_tracks(runs: Sequence[Run], estimates: Estimates, folder: Path) -> Path:
    """Draw the path of a star under jitter (figure 2) and all tracks (figures 5 and 6)."""
    figure = new_figure(figsize=(12, 4.5))
    axes = figure.subplots(1, 1 + len(runs))
    measured = [frame[index] for frame, index in zip(runs[0].centroids, runs[0].seen[:, 0])
                if index >= 0]
    axes[0].plot(*np.array(measured).T, '.', color='tab:grey', markersize=3, label='measured')
    axes[0].plot(*runs[0].uv[:, 0].T, linewidth=1, label='true')
    axes[0].set_title(f'2: a star under jitter, {FRAMES} frames')
    axes[0].legend()
    for axis, number, run, each in zip(axes[1:], (5, 6), runs, estimates):
        # In 400 frames a turning image moves its stars by some pixels only.
        times = {'linear': 1, 'turning': 10}[run.cell.motion]
        for star in range(STARS):
            start = run.uv[0, star]
            seen, true = (start + times * (uv[:, star] - start)
                          for uv in (each['JPDAF'].uv, run.uv))
            axis.plot(*seen.T, '.', markersize=2)
            axis.plot(*true.T, color='black', linewidth=0.5)
        axis.set_title(f'{number}: four stars, {run.cell.motion}'
                       + f', motion times {times}' * (times > 1))
    for axis in axes:
        axis.set(xlabel='u, px', ylabel='v, px')
        axis.invert_yaxis()
        axis.grid(alpha=0.3)
    return save_picture(figure, folder / 'jpdaf_tracks.png')


def draw_run(runs: Sequence[Run], estimates: Estimates, folder: Path) -> Path:
    """Draw the errors of attitude (figures 7, 8) and of a star (9, 10) over the frames."""
    figure = new_figure(figsize=(12, 7))
    axes = figure.subplots(2, len(runs), sharex=True)
    for column, (run, each) in enumerate(zip(runs, estimates)):
        for name, estimate in each.items():
            error = np.hypot(*attitude_error(estimate.quaternion, run.quaternion).T[:2])
            distance = np.linalg.norm(estimate.uv[:, 0] - run.uv[:, 0], axis=1)
            time_s = np.arange(FRAMES) * DT_S
            axes[0, column].plot(time_s, error / ARCSEC, linewidth=1, label=name)
            axes[1, column].plot(time_s, distance, linewidth=1, label=name)
        axes[0, column].set_title(f'{7 + column}: boresight error, arcsec: {run.cell}')
        axes[1, column].set_title(f'{9 + column}: distance of a star from the truth, px')
        axes[1, column].set_xlabel('s')
    for axis in axes.flat:
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend()
    return save_picture(figure, folder / 'jpdaf_run.png')
