# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Selection of frames for a calibration from a stream: few, with different pointings."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.calibration.estimate import covered_percent, star_shift
from startracker_ros.core.calibration.matching import View
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class CollectionOptions(Options):
    """Which frames are used for the calibration."""

    max_frames: int = option(
        50, 'number of frames; a new one replaces the oldest', low=2, high=500)
    min_shift_percent: float = option(
        5.0, 'smallest shift of the stars from every frame in use, relative to the image width; '
        'stars at the same pixels add no information', unit='%', low=0.0, high=100.0)


class ViewCollection:
    """The newest views of one camera that differ in pointing or roll."""

    def __init__(self, camera: Camera, options: CollectionOptions) -> None:
        self._camera = camera
        self._min_shift = options.min_shift_percent / 100
        self._frames: deque[tuple[View, np.ndarray]] = deque(maxlen=options.max_frames)

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, view: View, identified: np.ndarray) -> bool:
        """Add a view of a new pointing; identified (N,) marks its stars. Return whether added."""
        if self._frames:
            others = np.array([view.quaternion for view in self.views])
            if star_shift(self._camera, view.quaternion, others).min() < self._min_shift:
                return False
        self._frames.append((view, view.centroids.uv[identified]))
        return True

    @property
    def views(self) -> list[View]:
        """Return the views, oldest first."""
        return [view for view, _ in self._frames]

    @property
    def stars(self) -> int:
        """Return the number of identified stars in the views."""
        return sum(len(uv) for _, uv in self._frames)

    @property
    def covered_percent(self) -> float:
        """Return the percentage of the image that identified stars cover."""
        if not self._frames:
            return 0.0
        return covered_percent(self._camera, np.concatenate([uv for _, uv in self._frames]))
