# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which centroids of a frame are used, and which tracks are kept after it: compiled."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def usable_centroids(uv: np.ndarray, sigma_px: np.ndarray) -> tuple[np.ndarray, int]:
    """Return which centroids (N,) have a finite position and a positive sigma; how many not."""
    good, rejected = np.empty(len(uv), np.bool_), 0
    for n in range(len(uv)):
        good[n] = (np.isfinite(uv[n, 0]) and np.isfinite(uv[n, 1])
                   and np.isfinite(sigma_px[n]) and sigma_px[n] > 0)
        rejected += not good[n]
    return good, rejected


@compiled
def kept_tracks(crowded: np.ndarray, missed: np.ndarray, age: np.ndarray, confirmed: np.ndarray,
                most_missed: float) -> np.ndarray:
    """
    Return which tracks (N,) are kept: not near a planet, and not missed too often.

    Confirmed ones may be missed in most_missed frames in a row, new ones in half of their age.
    """
    kept = np.empty(len(missed), np.bool_)
    for n in range(len(missed)):
        kept[n] = not crowded[n] and missed[n] <= (most_missed if confirmed[n] else age[n] // 2)
    return kept


@compiled
def kept_after_fit(kept: np.ndarray, normalised: np.ndarray, most_sigmas: float,
                   missed: np.ndarray, age: np.ndarray, confirmed: np.ndarray, confirm_frames: int
                   ) -> tuple[np.ndarray, np.ndarray, int]:
    """
    Return which tracks (N,) are kept after a fit, which are confirmed, and how many are new.

    normalised (N,) are the residuals in sigma: an outlier is not kept. A track seen in this frame
    is confirmed from an age of confirm_frames on.
    """
    left, after, new = np.empty(len(kept), np.bool_), np.empty(len(kept), np.bool_), 0
    for n in range(len(kept)):
        seen = missed[n] == 0
        left[n] = kept[n] and not (seen and normalised[n] > most_sigmas)
        after[n] = confirmed[n] or (seen and age[n] >= confirm_frames)
        new += after[n] and not confirmed[n]
    return left, after, new
