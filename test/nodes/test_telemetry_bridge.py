# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""telemetry_bridge over DDS: what it receives is what it sends, and never more."""

from collections.abc import Callable, Iterator
from functools import partial
import socket

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3, Vector3Stamped
import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, Temperature
from skies import FRAME
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.track.tracks import TrackedAttitude
from startracker_ros.io.telemetry import nos3, space_packet
from startracker_ros.io.telemetry.report import TrackerCode
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import attitude_to_imu, tracked_attitude_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.rig import Rig

START_NS, STEP_NS = 1_790_000_000_000_000_001, 100_000_000
Q = np.array([0.1826, -0.3651, 0.5477, 0.7303]) / np.linalg.norm([0.1826, -0.3651, 0.5477, 0.7303])
SIGMA = np.array([1e-6, 2e-6, 3e-5])
RATE = np.array([0.01, -0.02, 0.03])


@pytest.fixture(scope='module')
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.setblocking(False)
        yield receiver


@pytest.fixture(scope='module')
def bridge(shared_rig: Rig, receiver: socket.socket) -> Rig:
    shared_rig.processes.start('telemetry_bridge', {
        'destination': f'udp://127.0.0.1:{receiver.getsockname()[1]}', 'apid': 42})
    return shared_rig


def imu(number: int, q: np.ndarray | None = Q) -> Imu | bytes:
    header = make_header(START_NS + number * STEP_NS, FRAME)
    if q is None:
        return attitude_to_imu(None, header)
    attitude = AttitudeEstimate(Q, np.diag(SIGMA ** 2), 5, np.zeros(5), 1.0)
    message = deserialize_message(tracked_attitude_to_imu(
        TrackedAttitude(attitude, RATE, np.eye(3)), header), Imu)
    message.orientation.x = float(q[0])
    return message


@pytest.fixture
def packet_of(bridge: Rig, receiver: socket.socket) -> Iterator[Callable[..., bytes]]:
    """Return a function that publishes an attitude until a packet is sent, and returns it."""
    probe = bridge.probe
    attitude = probe.advertise(Imu, 'attitude_imu', qos.LIST)

    def packet() -> bytes | None:
        try:
            return receiver.recv(1000)
        except BlockingIOError:
            return None

    def packet_of(*messages: Imu) -> bytes:
        # The bridge drops what it has sent already.
        return probe.send_until(lambda: [attitude.publish(message) for message in messages],
                                packet, 'a packet')
    yield packet_of
    probe.destroy_publisher(attitude)


def test_packets_hold_what_was_published(bridge: Rig, packet_of: Callable[..., bytes]):
    probe = bridge.probe
    state = probe.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
    temperature = probe.advertise(Temperature, 'temperature', qos.LIST)
    diagnostics = probe.advertise(DiagnosticArray, '/diagnostics', qos.LIST)
    first = space_packet.decode(packet_of(imu(0)))
    assert first.stamp_ns == START_NS
    assert (first.quaternion == Q).all()
    assert first.sigma_rad == pytest.approx(SIGMA, rel=1e-6)
    assert first.rate_rad_s == pytest.approx(RATE, rel=1e-6)
    assert first.state is TrackerCode.UNKNOWN
    state.publish(DiagnosticStatus(message='TRACKING', values=[
        KeyValue(key='stars_matched', value='37'), KeyValue(key='residual_px', value='0.061')]))
    numbers = iter(range(1, 10_000))
    protection = probe.advertise(Vector3Stamped, 'protection_level', qos.LIST)

    def bound(number: int, x: float) -> None:
        protection.publish(Vector3Stamped(header=imu(number).header,
                                          vector=Vector3(x=x, y=1.2e-5, z=float('inf'))))

    def complete() -> bool:
        temperature.publish(Temperature(temperature=-12.25))
        diagnostics.publish(DiagnosticArray(status=[
            DiagnosticStatus(hardware_id=name, values=[KeyValue(key='background_dn', value=value)])
            for name, value in (('star_tracker', '71.5'), ('other', '99'))]))
        number = next(numbers)
        bound(number, 6e-6)
        report = space_packet.decode(packet_of(imu(number)))
        if report.protection_rad is None:
            return False
        assert report.protection_rad == pytest.approx([6e-6, 1.2e-5, np.inf])
        return (report.state, report.stars, round(report.residual_px, 3), report.background_dn,
                report.temperature_c) == (TrackerCode.TRACKING, 37, 0.061, 71.5, -12.25)
    probe.wait(complete, 'state, background and temperature')
    # The bound of another frame is not that of this one.
    bound(10_002, 6e-6)
    assert space_packet.decode(packet_of(imu(10_001))).protection_rad is None
    # What no packet can hold is rejected, and packets go on.
    bound(10_003, float('nan'))
    state.publish(DiagnosticStatus(message='TRACKING', values=[
        KeyValue(key='stars_matched', value='-3'), KeyValue(key='residual_px', value='0.5')]))
    for publisher, message in (
            (temperature, Temperature(temperature=1e300)),
            (diagnostics, DiagnosticArray(status=[DiagnosticStatus(
                hardware_id='star_tracker',
                values=[KeyValue(key='background_dn', value='many')])]))):
        probe.publish_until_received(publisher, message)
    for topic in ('tracker_state', 'temperature', '/diagnostics', 'protection_level'):
        probe.wait(partial(probe.diagnostic_value, 'telemetry_bridge: telemetry',
                           f'{topic} rejected'), f'{topic} rejected')
    assert (space_packet.decode(packet_of(imu(10_004))).quaternion == Q).all()
    # Without an attitude: sent, and marked.
    packet = packet_of(imu(20_000, None))
    assert space_packet.decode(packet).quaternion is None
    assert not any(space_packet.values(packet)[f'Q_{axis}'] for axis in 'XYZW')
    # What is not an attitude, or not newer: not sent at all.
    last = packet_of(imu(20_001, np.full(4, np.nan)), imu(20_002, 3 * Q), imu(20_000),
                     imu(20_003))
    assert space_packet.decode(last).stamp_ns == START_NS + 20_003 * STEP_NS
    assert space_packet.sequence_of(last) == space_packet.sequence_of(packet) + 1
    probe.wait_diagnostic('sending ccsds packets')


def test_the_packet_can_be_changed_while_it_runs(bridge: Rig, packet_of: Callable[..., bytes]):
    response = bridge.probe.call(
        SetParametersAtomically, 'telemetry_bridge/set_parameters_atomically',
        SetParametersAtomically.Request(
            parameters=[Parameter('packet_format', value='nos3').to_parameter_msg()]))
    assert response.result.successful, response.result.reason
    quaternion, valid = nos3.decode(packet_of(imu(30_000)))
    assert valid
    assert np.abs(quaternion - Q).max() <= 0.5 / 32767
    assert nos3.decode(packet_of(imu(30_001, None)))[1] is False
