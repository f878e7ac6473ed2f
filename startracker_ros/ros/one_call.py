# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One call for each frame where extractor, tracker and estimator are nodes of one process."""

from dataclasses import replace
from functools import partial
from typing import Any, TYPE_CHECKING

from startracker_ros.core.camera.model import Camera

if TYPE_CHECKING:
    from startracker_ros.core.stages.frame_path import FramePath
    from startracker_ros.io.bags.layouts import StarImage


class OneCall:
    """
    The frame path of extractor, tracker and estimator, each of which joins by its attribute.

    The tracker builds the path with the options of all three; they use its stages. While all
    are active and set up for one camera, a frame is one call, and its attitude goes out before
    anything else is published. Otherwise each node calls its own stage, on the same path.
    """

    def __init__(self) -> None:
        # Nodes: their modules are above this one.
        self.extractor: Any = None
        self.tracker: Any = None
        self.estimator: Any = None
        self.path: FramePath | None = None
        self._cameras: tuple[Any, ...] = ()
        self._same_camera = False

    @property
    def is_complete(self) -> bool:
        """Whether all three are in this process, and the estimator uses what the tracker does."""
        return (None not in (self.extractor, self.tracker, self.estimator)
                and self.estimator.uses_path_of(self.tracker))

    def builder(self, camera: Camera, epoch_year: float, *others: Any) -> partial:
        """Return the function that builds a path with the options of all three, and others."""
        # A node alone loads no other stage.
        from startracker_ros.core.stages.frame_path import make_frame_path
        from startracker_ros.core.stages.parameters import NODES, StarTrackerOptions
        nodes = dict(zip(NODES, (self.extractor, None, self.tracker, self.estimator)))
        defaults = StarTrackerOptions()
        return partial(make_frame_path, camera, epoch_year, replace(defaults, **{
            name: node.options(type(getattr(defaults, name)))
            for key, node in nodes.items() if node is not None for name in NODES[key]}), *others)

    def adopt(self, path: 'FramePath') -> None:
        """Let all use the stages of a path that the tracker has built."""
        self.path = path
        for node in (self.extractor, self.estimator):
            node.use_path(path)

    def restart(self) -> None:
        """Let the tracker build another path, as the extractor restarts."""
        if self.path is not None:
            self.path = None
            self.tracker.rebuild_configured()

    def process(self, stamp_ns: int, image: 'StarImage', exposure_s: float, frame_id: str
                ) -> 'FramePath | None':
        """Process an image, publish its attitude; return None where each stage is to be called."""
        path = self.path
        if path is None or not self._is_ready(path) or not path.process(
                stamp_ns, image.pixels, image.cell, exposure_s):
            return None
        self.tracker.take_processed(stamp_ns)
        self.estimator.guard('tracks', lambda: self.estimator.publish_processed(
            stamp_ns, frame_id, path))
        return path

    def _is_ready(self, path: 'FramePath') -> bool:
        """Return whether all are active and set up for one camera."""
        nodes = self.extractor, self.tracker, self.estimator
        if not all(node.active and node.is_set_up for node in nodes) or (
                self.tracker.follows_target):
            return False
        cameras = (path.camera, *(node.camera for node in nodes))
        if len(self._cameras) != len(cameras) or any(
                one is not other for one, other in zip(self._cameras, cameras)):
            self._cameras = cameras
            self._same_camera = all(path.camera.is_same(camera) for camera in cameras[1:])
        return self._same_camera
