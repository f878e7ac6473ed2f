"""tracks and tracked_attitude of one frame, which may come in either order."""

from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.clouds import tracks_from_message

_TRACKED = 'tracked_attitude'


class TracksInput:
    """
    Subscribes to both topics and pairs them by stamp; of each as many wait as its queue holds.

    on_frame(stamp_ns, tracks, tracked) has the attitude of the tracker, None for a frame without,
    on_tracks_alone(stamp_ns, tracks) is for a tracker that publishes none.
    """

    def __init__(self, node: CameraNode,
                 on_frame: Callable[[int, Tracks, TrackedAttitude | None], None],
                 on_tracks_alone: Callable[[int, Tracks], None]) -> None:
        self._node = node
        self._on_frame = on_frame
        self._on_tracks_alone = on_tracks_alone
        self._tracked: dict[int, TrackedAttitude | None] = {}
        self._waiting: dict[int, PointCloud2] = {}
        node.subscribe(Imu, _TRACKED, self._on_tracked, qos.LIST)
        node.subscribe(PointCloud2, 'tracks', self._on_tracks, qos.LIST)

    def clear(self) -> None:
        """Forget what waits."""
        self._tracked.clear()
        self._waiting.clear()

    def _on_tracked(self, message: Imu) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._tracked[stamp_ns] = tracked_attitude_from_imu(message)
        if len(self._tracked) > qos.LIST.depth:
            del self._tracked[next(iter(self._tracked))]
        # Both topics are in the order of the frames: an older one will not come any more.
        for older_ns in [waiting_ns for waiting_ns in self._waiting if waiting_ns < stamp_ns]:
            self._drop(older_ns)
        if stamp_ns in self._waiting:
            self._use(stamp_ns, self._waiting.pop(stamp_ns))

    def _on_tracks(self, message: PointCloud2) -> None:
        node, stamp_ns = self._node, ns_from_stamp(message.header.stamp)
        if node.camera_or_drop() is None or not node.in_order('tracks', message.header.stamp):
            return
        if stamp_ns in self._tracked:
            self._use(stamp_ns, message)
        elif not node.count_publishers(_TRACKED):
            self._on_tracks_alone(stamp_ns, tracks_from_message(message))
        else:
            self._waiting[stamp_ns] = message
            if len(self._waiting) > qos.LIST.depth:
                self._drop(next(iter(self._waiting)))

    def _use(self, stamp_ns: int, message: PointCloud2) -> None:
        """Use a frame of which both are here; tracks that cannot be read are named as such."""
        self._node.guard('tracks', partial(self._use_tracks, stamp_ns, message))

    def _use_tracks(self, stamp_ns: int, message: PointCloud2) -> None:
        self._on_frame(stamp_ns, tracks_from_message(message), self._tracked[stamp_ns])

    def _drop(self, stamp_ns: int) -> None:
        del self._waiting[stamp_ns]
        self._node.diagnostics.counts['tracks without tracked_attitude'] += 1
