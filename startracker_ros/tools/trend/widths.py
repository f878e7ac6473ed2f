# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Maps of the width of star images over the image, by month."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.tools.reprocess.runs import Run
from startracker_ros.tools.reprocess.widths import GRID, width_px

LEAST_STARS = 100
"""Stars of a cell whose width is known, to 5 %."""

MIDDLE = slice(GRID // 4, GRID - GRID // 4)


@dataclass(frozen=True)
class WidthMap:
    """
    The widths of star images in a month, 1 sigma in px.

    width_px (GRID, GRID) by row and column of the cells, NaN with fewer than LEAST_STARS; middle
    and edge are those of the middle half of both axes and of the rest, with their 1 sigma.
    """

    tracker: str
    month: str
    width_px: np.ndarray
    middle: tuple[float, float]
    edge: tuple[float, float]


def width_maps(run: Run, tracker: str) -> list[WidthMap]:
    """Return the map of each month of a tracker."""
    table = run.table('widths', tracker, ['stamp_ns', 'column', 'row', 'count', 'square_px2'])
    months = table['stamp_ns'].astype('datetime64[ns]').astype('datetime64[M]')
    maps = []
    for month in np.unique(months):
        chosen = months == month
        cell = (table['row'][chosen].astype(int) * GRID + table['column'][chosen])
        count, square = (np.bincount(cell, table[name][chosen], GRID ** 2).reshape(GRID, GRID)
                         for name in ('count', 'square_px2'))
        middle = np.zeros((GRID, GRID), bool)
        middle[MIDDLE, MIDDLE] = True
        with np.errstate(invalid='ignore', divide='ignore'):
            width = np.where(count >= LEAST_STARS, np.sqrt(square / count), np.nan)
        maps.append(WidthMap(tracker, str(month), width, *(
            width_px(float(square[part].sum()), int(count[part].sum()))
            for part in (middle, ~middle))))
    return maps
