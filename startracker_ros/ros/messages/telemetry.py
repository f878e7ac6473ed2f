# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of the nodes to the frame report of telemetry."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from sensor_msgs.msg import Imu, Temperature
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
from startracker_ros.io.telemetry.report import FrameReport, TrackerCode
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu


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
        state, stars = TrackerCode[message.message], int(values['stars_matched'])
        residual_px = _single(values['residual_px'], 'residual_px')
    except (KeyError, ValueError) as error:
        raise MessageError(f'state {message.message!r} with {values}: {error!r}') from error
    if stars < 0:
        raise MessageError(f'stars_matched {stars} is negative')
    return state, stars, residual_px


def temperature_from_message(message: Temperature) -> float:
    """Return the temperature in deg C; MessageError for what no packet can hold."""
    return _single(message.temperature, 'temperature')


def background_from_diagnostics(message: DiagnosticArray, hardware_id: str) -> float | None:
    """
    Return the background in DN that the extractor of a star tracker reports, None without.

    MessageError for what is not a number.
    """
    for status in message.status:
        if status.hardware_id == hardware_id:
            for pair in status.values:
                if pair.key == 'background_dn':
                    return _single(pair.value, 'background_dn')
    return None


def _single(value: str | float, name: str) -> float:
    """Return a number of single precision, NaN for one that is not known; MessageError."""
    try:
        number = float(value)
    except ValueError as error:
        raise MessageError(f'{name} {value!r} is not a number') from error
    if abs(number) > np.finfo(np.float32).max:
        raise MessageError(f'{name} {number:g} is out of the range of single precision')
    return number
