# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of a source that is frozen: two exposures never have the same noise."""

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids

REPEATED = 'the centroids are those of the frame before, with their noise'
_MEASURED_PX = 0.02  # by which one image may give other positions, searched in another way


class Repetition:
    """Compares each frame of centroids with the one before it that has any."""

    def __init__(self) -> None:
        self._before = np.empty((0, 2))
        self._vary = False

    def add(self, frame: Centroids) -> bool:
        """
        Add a frame; return whether it is the one before, of a source whose frames have differed.

        A frame that is shown again and again from the start is no fault.
        """
        if not len(frame):
            return False
        # A caller may use the same array again.
        before, self._before = self._before, frame.uv.copy()
        if len(before) and not self._vary:
            brightest_px = np.linalg.norm(before - frame.uv[0], axis=1).min()
            self._vary = bool(brightest_px > _MEASURED_PX)
        return self._vary and np.array_equal(before, frame.uv)
