"""The state of the star tracker on its topic and in the diagnostics."""

from diagnostic_msgs.msg import DiagnosticStatus
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.node import PipelineNode
from startracker_ros.track.tracker import StarTracker, TrackerState


class TrackerStateOutput:
    """Publishes tracker_state."""

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        self._publisher = node.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)

    def publish(self, tracker: StarTracker) -> None:
        """Publish the state of a tracker, and report it as the condition of the node."""
        diagnostics = self._node.diagnostics
        level = OK if tracker.state is TrackerState.TRACKING else WARN
        values = {'stars_matched': tracker.stars_matched,
                  'residual_px': f'{tracker.residual_px:.3f}',
                  'frames_since_fix': tracker.frames_since_fix,
                  'checks_passed': tracker.checks_passed,
                  'late_frames': tracker.late_frames,
                  'rejected_centroids': tracker.rejected_centroids,
                  'gyro': tracker.gyro_condition,
                  'reason': tracker.contradiction or tracker.reason}
        self._publisher.publish(status_message(
            'star_tracker: state', self._node.hardware_id, level, tracker.state.value, values))
        diagnostics.values.update(values)
        if tracker.contradiction:
            diagnostics.counts['contradictory frames'] += 1
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.contradiction}')
        elif tracker.gyro_trouble:
            diagnostics.report(WARN, f'{tracker.state.value}: {tracker.gyro_trouble}')
        else:
            diagnostics.report(level, f'{tracker.state.value}: {tracker.reason}')
