"""Frames for a calibration, picked out of a stream: few, and each of another pointing."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from startracker_ros.calibration.estimate import covered_percent, moved
from startracker_ros.calibration.matching import View
from startracker_ros.camera.model import Camera
from startracker_ros.options import option, Options


@dataclass(frozen=True)
class CollectionOptions(Options):
    """Which frames are kept for the calibration."""

    max_frames: int = option(
        50, 'frames kept; the oldest makes room for a new one', low=2, high=500)
    min_shift_percent: float = option(
        5.0, 'how far the stars must have moved since every frame kept, in widths of the image: '
        'at the same pixels they tell nothing new', unit='%', low=0.0, high=100.0)


class ViewCollection:
    """The newest views of one camera that differ in pointing or roll."""

    def __init__(self, camera: Camera, options: CollectionOptions) -> None:
        self._camera = camera
        self._least_shift = options.min_shift_percent / 100
        self._kept: deque[tuple[View, np.ndarray]] = deque(maxlen=options.max_frames)

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, view: View, identified: np.ndarray) -> bool:
        """Keep a view unless its pointing is there already; identified (N,) marks known stars."""
        if self._kept:
            others = np.array([view.quaternion for view in self.views])
            if moved(self._camera, view.quaternion, others).min() < self._least_shift:
                return False
        self._kept.append((view, view.centroids.uv[identified]))
        return True

    @property
    def views(self) -> list[View]:
        """Return the views kept, oldest first."""
        return [view for view, _ in self._kept]

    @property
    def stars(self) -> int:
        """How many identified stars the views hold."""
        return sum(len(uv) for _, uv in self._kept)

    @property
    def covered_percent(self) -> float:
        """Return the share of the image where identified stars were seen."""
        if not self._kept:
            return 0.0
        return covered_percent(self._camera, np.concatenate([uv for _, uv in self._kept]))
