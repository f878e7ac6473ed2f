# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hot pixels of a run: where spots that are no star come again and again."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.tools.reprocess.runs import Run


@dataclass(frozen=True)
class PixelRow:
    """A hot pixel: the frames that have it, and the begins of its first and last segment."""

    tracker: str
    u: int
    v: int
    frames: int
    first: str
    last: str


def hot_pixels(run: Run, tracker: str) -> list[PixelRow]:
    """Return the hot pixels of a tracker, those of most frames first."""
    table = run.table('hot_pixels', tracker, ['stamp_ns', 'u', 'v', 'count'])
    if not len(table['stamp_ns']):
        return []
    pixels, first, which = np.unique(np.stack([table['u'], table['v']], -1), axis=0,
                                     return_index=True, return_inverse=True)
    which = which.ravel()
    frames = np.bincount(which, table['count']).astype(int)
    last = np.zeros(len(pixels), np.int64)
    np.maximum.at(last, which, table['stamp_ns'])
    return [PixelRow(tracker, int(pixels[k, 0]), int(pixels[k, 1]), int(frames[k]),
                     utc(int(table['stamp_ns'][first[k]])), utc(int(last[k])))
            for k in np.argsort(-frames, kind='stable')]
