# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One picture of a run: the star field with names, and the attitude error over time."""

from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.extras import new_figure, PAGE_IN
from startracker_ros.core.stages.annotate import annotate, Labels
from startracker_ros.io.output import write_picture
from startracker_ros.io.recordings.recording import gaps_after, Recording


def draw_error(axis: Any, time_s: np.ndarray, error: np.ndarray, sigma: np.ndarray, label: str,
               *, markersize: float) -> None:
    """
    Draw errors (N,) over time_s (N,) on axes of matplotlib, between their 3 sigma bounds.

    Nothing is drawn over a gap of the times.
    """
    gaps = gaps_after(time_s) + 1
    band_s, three = np.insert(time_s, gaps, time_s[gaps]), np.insert(3 * sigma, gaps, np.nan)
    axis.fill_between(band_s, -three, three, color='tab:blue', alpha=0.15,
                      label='3 sigma', linewidth=0)
    axis.plot(time_s, error, '.', markersize=markersize, color='tab:blue', label='error')
    axis.axhline(0, color='black', linewidth=0.5)
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)


def draw_field(axis: Any, image: np.ndarray, uv: np.ndarray, hip: np.ndarray, title: str, *,
               bare: np.ndarray = np.empty((0, 2))) -> None:
    """Draw an image (H, W) with its stars, half a page wide; no label is on a pixel of bare."""
    labels = Labels(image.shape, np.vstack([uv, bare]), share=0.5)
    axis.imshow(annotate(image, uv, hip, labels=labels))
    axis.set(xlabel='u [px]', ylabel='v [px]', title=title)


def draw_run(path: Path, recording: Recording, image: np.ndarray, uv: np.ndarray,
             hip: np.ndarray, title: str) -> None:
    """Write a PNG: image (H, W) with tracks at uv (N, 2), labelled with hip (N,)."""
    figure = new_figure(figsize=(PAGE_IN, 5.6))
    figure.suptitle(title)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.25, 1))
    draw_field(figure.add_subplot(grid[:, 0]), image, uv, hip,
               f'{np.count_nonzero(hip)} stars identified, {np.count_nonzero(hip == 0)} not yet')
    stamps, error, sigma = recording.errors()
    time_s = (stamps - recording.image_ns[0]) / 1e9 if len(stamps) else stamps
    axis: Any = None
    for row, name in enumerate(('x, cross', 'y, cross', 'z, roll')):
        axis = figure.add_subplot(grid[row, 1], sharex=axis)
        draw_error(axis, time_s, error[:, row], sigma[:, row], f'{name}\n[arcsec]', markersize=2)
        if len(stamps):
            # The wide bounds of the first frames may leave the picture, no error may.
            limit = max(4.5 * np.nanmedian(sigma[:, row]), 1.1 * np.abs(error[:, row]).max())
            axis.set_ylim(-limit, limit)
    axis.set_xlabel('time since the first image [s]')
    figure.axes[1].legend(loc='upper right', ncols=2)
    figure.axes[1].set_title('attitude error against truth')
    write_picture(path, figure, dpi=165)
