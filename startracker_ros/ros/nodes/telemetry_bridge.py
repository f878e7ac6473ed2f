# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""telemetry_bridge: attitude_imu, protection_level, states and conditions -> packets."""

from dataclasses import replace
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
import numpy as np
from sensor_msgs.msg import Imu, Temperature
from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.extras import MissingLibraryError
from startracker_ros.io.bags.layouts import ns_from_stamp, protection_from_message
from startracker_ros.io.telemetry.link import Encoder, Link, LinkError, TelemetryOptions
from startracker_ros.io.telemetry.report import FrameReport, TelemetryError
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.telemetry import (
    background_from_diagnostics, report_from_imu, state_from_status, temperature_from_message)
from startracker_ros.ros.node import main_of, PipelineNode, StartError

_VALID_S = 3.0
"""A condition that was reported longer ago is not known any more."""


class TelemetryBridgeNode(PipelineNode):
    """Sends a packet for each frame; an attitude that is not trusted is never sent as valid."""

    option_classes = (TelemetryOptions,)
    task = 'telemetry'

    def __init__(self) -> None:
        super().__init__('telemetry_bridge')
        self._link: Link | None = None
        # Before attitude_imu, as attitude_estimator publishes it before.
        self.subscribe(Vector3Stamped, 'protection_level', self._on_protection, qos.LIST)
        self.subscribe(Imu, 'attitude_imu', self._on_attitude_imu, qos.LIST)
        self.subscribe(DiagnosticStatus, 'tracker_state', self._on_tracker_state, qos.STATE)
        self.subscribe(Temperature, 'temperature', self._on_temperature, qos.LIST)
        self.subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.LIST)

    def rebuild(self) -> None:
        self.close()
        options = self.options(TelemetryOptions)
        try:
            self._encoder = Encoder(options)
            self._link = Link(options.destination)
        except (LinkError, MissingLibraryError) as error:
            raise StartError(str(error)) from error
        self._newest_ns: int | None = None
        self._known: dict[str, tuple[float, dict[str, Any]]] = {}
        self._protection: tuple[int, np.ndarray] | None = None

    def cleanup(self) -> None:
        self.close()

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _set(self, source: str, **values: Any) -> None:
        self._known[source] = time.monotonic(), values

    def _on_tracker_state(self, message: DiagnosticStatus) -> None:
        state, stars, residual_px = state_from_status(message)
        self._set('tracker_state', state=state, stars=stars, residual_px=residual_px)

    def _on_temperature(self, message: Temperature) -> None:
        self._set('temperature', temperature_c=temperature_from_message(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        background_dn = background_from_diagnostics(message, self.hardware_id)
        if background_dn is not None:
            self._set('background', background_dn=background_dn)

    def _on_protection(self, message: Vector3Stamped) -> None:
        self._protection = (ns_from_stamp(message.header.stamp),
                            protection_from_message(message))

    def _on_attitude_imu(self, message: Imu) -> None:
        report = report_from_imu(message)
        if (self._newest_ns is not None
                and 0 <= self._newest_ns - report.stamp_ns <= RESTART_NS):
            self.diagnostics.counts['attitude_imu out of order'] += 1
            return
        self._newest_ns = report.stamp_ns
        oldest_s = time.monotonic() - _VALID_S
        for set_s, values in self._known.values():
            if set_s > oldest_s:
                report = replace(report, **values)
        if self._protection is not None and self._protection[0] == report.stamp_ns:
            report = replace(report, protection_rad=self._protection[1])
        self._send(report)

    def _send(self, report: FrameReport) -> None:
        """Send the packet of a frame and report what was sent."""
        assert self._link is not None
        options, counts = self.options(TelemetryOptions), self.diagnostics.counts
        try:
            self._link.send(self._encoder.encode(report))
        except (OSError, TelemetryError) as error:
            counts['packets not sent'] += 1
            self.diagnostics.report(ERROR, f'{options.destination}: {error}')
            return
        trusted = report.quaternion is not None
        counts['packets sent'] += 1
        counts['of these without attitude'] += not trusted
        self.diagnostics.report(OK if trusted else WARN, f'sending {options.packet_format} packets'
                                f'{"" if trusted else " without an attitude"}')


main = main_of(TelemetryBridgeNode)

if __name__ == '__main__':
    main()
