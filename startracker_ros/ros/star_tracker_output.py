# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the star tracker publishes: its state, expected centroids, and its target."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.core.astro.exclusion import BlindingForecast, ExclusionOptions, HORIZON_S
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.maths.rotation import turned
from startracker_ros.core.stages.bodies import Bodies, BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.target import TargetTracker
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.cloud_rows import STATE_NAME, tracker_state_values
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.clouds import centroids_to_message, predictions_to_message
from startracker_ros.ros.node import PipelineNode, publish_value
from startracker_ros.ros.odometry_input import OdometryInput
from std_msgs.msg import Header

_FORECAST_NS = 1_000_000_000


class TrackerStateOutput:
    """
    Publishes tracker_state, with the time until the head is blinded and until it is no more.

    The attitude of that is the newest one of tracked and hinted ones, at a constant rate since.
    tracker_status is the same with a header: the stamp of the newest frame, zero before the first.
    """

    def __init__(self, node: CameraNode, observer: OdometryInput) -> None:
        self._node = node
        self._observer = observer
        self._newest_ns = self._forecast_ns = 0
        self._has_tracked = False
        self._blinding: dict[str, object] = {}
        self._known: tuple[int, np.ndarray, np.ndarray] | None = None
        self._state = node.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
        self._status = node.advertise(DiagnosticArray, 'tracker_status', qos.STATE)

    def begin(self, tracker: TrackFilter) -> None:
        """Publish the state of a new tracker; name the options that have no effect with it."""
        options = self._node.options(TrackerOptions)
        gyro = self._node.options(GyroErrorOptions)
        ignored = options.ignored + ([] if options.reads_gyro else gyro.changed)
        if ignored:
            self._node.diagnostics.report_event(
                f'no effect with model = {options.model}: {", ".join(ignored)}')
        self.publish(tracker)

    def publish(self, tracker: TrackFilter, stamp_ns: int | None = None) -> None:
        """
        Publish the state of a tracker, and report it as the condition of the node.

        stamp_ns is that of the newest frame, if it is new.
        """
        self._newest_ns = stamp_ns or self._newest_ns
        if stamp_ns is not None and abs(stamp_ns - self._forecast_ns) >= _FORECAST_NS:
            self._forecast_ns = stamp_ns
            self._blinding = self._forecast(tracker, stamp_ns)
        diagnostics = self._node.diagnostics
        level = OK if tracker.state is TrackerState.TRACKING else WARN
        self._has_tracked |= level == OK
        values = {**tracker_state_values(tracker), **self._blinding}
        status = cdr.status(
            level[0], STATE_NAME, tracker.state.value, self._node.hardware_id, values)
        self._state.publish(status)
        self._status.publish(cdr.status_array(
            self._newest_ns, self._node.sensor_frame_id, status))
        diagnostics.values.update(values)
        if tracker.contradiction:
            diagnostics.counts['contradictory frames'] += 1
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.contradiction}')
        elif tracker.gyro_trouble:
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.gyro_trouble}')
        elif tracker.stamp_sigma_s:
            error_ms = f'{tracker.stamp_sigma_s * 1e3:.2g} ms'
            diagnostics.report(WARN, f'{tracker.state.value}: timestamp errors of {error_ms}: '
                               'stamp frames in the driver, at the middle of the exposure')
        else:
            diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}',
                               expected=not self._has_tracked)

    def _forecast(self, tracker: TrackFilter, stamp_ns: int) -> dict[str, object]:
        """Return the values of the blinding to come, none where the attitude is unknown."""
        tracked, hint = tracker.attitude, tracker.newest_hint
        if tracked is not None:
            self._known = stamp_ns, tracked.attitude.quaternion, tracked.rate_rad_s
        elif hint is not None and (self._known is None or hint.stamp_ns > self._known[0]):
            self._known = hint.stamp_ns, hint.quaternion, hint.rate
        if self._known is None:
            return {}
        known_ns, quaternion, rate_rad_s = self._known
        age_s = (stamp_ns - known_ns) * 1e-9
        if abs(age_s) > HORIZON_S or self._observer.motion.why_no_date(stamp_ns):
            return {}
        blinding = BlindingForecast(self._node.options(ExclusionOptions)).at(
            stamp_ns, turned(quaternion, rate_rad_s * age_s), rate_rad_s,
            self._observer.motion.geocentric(stamp_ns))
        if blinding is None:
            return {}
        return {'blinding_body': blinding.body or 'none',
                'seconds_to_blinding': f'{round(blinding.in_s, 1):g}',
                'seconds_to_return': f'{round(blinding.return_s, 1):g}',
                **{f'{name.lower()}_limb_deg': f'{angle:.2f}'
                   for name, angle in blinding.limb_deg.items()}}


class PredictionsOutput:
    """Publishes predicted_centroids, and reports the bodies in the image."""

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        self._publisher = node.advertise(PointCloud2, 'predicted_centroids', qos.LIST)

    def publish(self, tracker: TrackFilter, targets: PredictedCentroids | None, camera: Camera,
                header: Header) -> None:
        """Publish what the newest frame predicts, with the targets of its time."""
        bodies = _bodies(tracker, camera, ns_from_stamp(header.stamp))
        self._node.diagnostics.values['bodies'] = ', '.join(
            body.name for body in bodies) or 'none'
        predicted = tracker.predicted
        if predicted is not None and targets is not None:
            predicted = predicted.joined(targets)
        publish_value(
            self._publisher, header,
            (predicted or PredictedCentroids.none(ns_from_stamp(header.stamp)), bodies),
            partial(predictions_to_message, predicted, header, bodies))


def _bodies(tracker: TrackFilter, camera: Camera, stamp_ns: int) -> tuple[BodyInImage, ...]:
    """Return planets, Moon and Sun at the newest frame, none without an attitude."""
    tracked, observer = tracker.attitude, tracker.sky.at(stamp_ns).observer
    if tracked is None:
        return ()
    return Bodies(observer.bodies).in_image(
        SkyMapping(camera, tracked.attitude.quaternion, observer.state))


class TargetOutput:
    """Searches each frame for the target and publishes it, while anybody subscribes."""

    def __init__(self, node: PipelineNode) -> None:
        self._diagnostics = node.diagnostics
        self._publisher = node.advertise(PointCloud2, 'target_centroid', qos.LIST)

    @property
    def is_wanted(self) -> bool:
        """Whether anybody subscribes."""
        return bool(self._publisher.get_subscription_count())

    def update(self, targets: TargetTracker, stars: TrackFilter, centroids: Centroids,
               windowed: bool, camera: Camera, header: Header) -> PredictedCentroids | None:
        """
        Publish the target of a frame, an empty cloud if there is none.

        Return where it is and what may become one, None without a subscriber or an attitude.
        """
        tracked = stars.attitude
        if tracked is None or not self.is_wanted:
            return None
        target = targets.update(
            ns_from_stamp(header.stamp), tracked.attitude, centroids, windowed)
        self._publisher.publish(centroids_to_message(
            Centroids.empty() if target is None else target.centroid, camera, header))
        self._diagnostics.values.update(
            spots_without_star=targets.spots,
            target='none' if target is None else f'{target.rate_deg_s:.4f} deg/s')
        return targets.predicted(tracked.rate_rad_s)
