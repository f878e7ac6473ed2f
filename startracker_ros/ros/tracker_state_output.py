"""The state of the star tracker on its topic and in the diagnostics."""

from diagnostic_msgs.msg import DiagnosticStatus
from startracker_ros.astro.exclusion import BlindingForecast, ExclusionOptions
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.track.tracker import StarTracker, TrackerState

_FORECAST_NS = 1_000_000_000


class TrackerStateOutput:
    """
    Publishes tracker_state, with the time until the head is blinded and until it is no more.

    The attitude of that is the tracked one, without it that of the last hint.
    """

    def __init__(self, node: PipelineNode, observer: OdometryInput) -> None:
        self._node = node
        self._observer = observer
        self._forecast_ns = 0
        self._blinding: dict[str, object] = {}
        self._publisher = node.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)

    def publish(self, tracker: StarTracker, stamp_ns: int | None = None) -> None:
        """
        Publish the state of a tracker, and report it as the condition of the node.

        stamp_ns is that of the newest frame, if it is new.
        """
        if stamp_ns is not None and abs(stamp_ns - self._forecast_ns) >= _FORECAST_NS:
            self._forecast_ns = stamp_ns
            self._blinding = self._forecast(tracker, stamp_ns)
        diagnostics = self._node.diagnostics
        level = OK if tracker.state is TrackerState.TRACKING else WARN
        values: dict[str, object] = {
            'stars_matched': tracker.stars_matched,
            'residual_px': f'{tracker.residual_px:.3f}',
            'frames_since_fix': tracker.frames_since_fix,
            'checks_passed': tracker.checks_passed,
            'late_frames': tracker.late_frames,
            'rejected_centroids': tracker.rejected_centroids,
            'gyro': tracker.gyro_condition,
            'stamp_sigma_ms': f'{tracker.stamp_sigma_s * 1e3:.3f}',
            'reason': tracker.contradiction or tracker.reason}
        values.update(self._blinding)
        self._publisher.publish(status_message(
            'star_tracker: state', self._node.hardware_id, level, tracker.state.value, values))
        diagnostics.values.update(values)
        if tracker.contradiction:
            diagnostics.counts['contradictory frames'] += 1
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.contradiction}')
        elif tracker.gyro_trouble:
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.gyro_trouble}')
        elif tracker.stamp_sigma_s:
            error_ms = f'{tracker.stamp_sigma_s * 1e3:.2g} ms'
            diagnostics.report(WARN, f'{tracker.state.value}: stamps err by {error_ms}: '
                               'stamp frames in the driver, at the middle of the exposure')
        else:
            diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}')

    def _forecast(self, tracker: StarTracker, stamp_ns: int) -> dict[str, object]:
        """Return the values of the blinding to come, none where the attitude is unknown."""
        tracked, hint = tracker.attitude, tracker.hints.newest
        if tracked is not None:
            quaternion, rate_rad_s = tracked.attitude.quaternion, tracked.rate_rad_s
        elif hint is not None:
            stamp_ns, quaternion, rate_rad_s = hint.stamp_ns, hint.quaternion, hint.rate
        else:
            return {}
        blinding = BlindingForecast(self._node.options(ExclusionOptions)).at(
            stamp_ns, quaternion, rate_rad_s, self._observer.motion.geocentric(stamp_ns))
        if blinding is None:
            return {}
        return {'blinding_body': blinding.body or 'none',
                'seconds_to_blinding': f'{blinding.in_s:g}',
                'seconds_to_return': f'{blinding.return_s:g}',
                **{f'{name.lower()}_limb_deg': f'{angle:.2f}'
                   for name, angle in blinding.limb_deg.items()}}
