"""Messages of the nodes to the frame report of telemetry."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from sensor_msgs.msg import Imu
from startracker_ros.bag.layouts import MessageError, ns_from_stamp
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.telemetry.report import FrameReport, TrackerCode


def report_from_imu(message: Imu) -> FrameReport:
    """Return what `attitude_imu` says; MessageError where its attitude or rate cannot be right."""
    stamp_ns = ns_from_stamp(message.header.stamp)
    tracked = tracked_attitude_from_imu(message)
    if tracked is None:
        return FrameReport(stamp_ns)
    variance = np.diag(tracked.attitude.covariance_sensor)
    if not (variance > 0).all():
        raise MessageError(f'orientation covariance of diagonal {variance.tolist()} about sensor '
                           'axes is not positive')
    rate = None if tracked.rate_covariance[0, 0] == -1 else tracked.rate_rad_s
    if rate is not None and not np.isfinite(rate).all():
        raise MessageError(f'angular velocity {rate.tolist()} is not finite')
    return FrameReport(stamp_ns, tracked.attitude.quaternion, np.sqrt(variance), rate)


def state_from_status(message: DiagnosticStatus) -> tuple[TrackerCode, int, float]:
    """Return state, stars matched and residual in px of `tracker_state`; MessageError."""
    values = {pair.key: pair.value for pair in message.values}
    try:
        return (TrackerCode[message.message], int(values['stars_matched']),
                float(values['residual_px']))
    except (KeyError, ValueError) as error:
        raise MessageError(f'state {message.message!r} with {values}: {error!r}') from error


def background_from_diagnostics(message: DiagnosticArray, hardware_id: str) -> float | None:
    """Return the background in DN that the extractor of a star tracker reports, None without."""
    for status in message.status:
        if status.hardware_id == hardware_id:
            for pair in status.values:
                if pair.key == 'background_dn':
                    return float(pair.value)
    return None
