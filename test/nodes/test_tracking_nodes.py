# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Identifier, tracker and estimator over DDS, with a gyro that helps and one that misleads."""

from dataclasses import replace
import itertools
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import CAMERA, FRAME, onboard_stars, START_NS
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.orbit import CircularOrbit, orbit_frame
from startracker_ros.core.astro.state import State
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, multiply, quaternion_from_matrix,
    quaternion_from_pointing, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)
from startracker_ros.ros.messages.clouds import centroids_to_message, tracks_to_message
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.messages.odometry import state_to_odometry

ONBOARD = onboard_stars(CAMERA, 2026.7, 6.5)
STEP_NS = 100_000_000
RATE = np.radians([0.05, 0.3, 0.1])
CHECK_NS = 1_000_000_000
STATES = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Flight:
    """A camera that turns at a steady rate, with a gyro of 100 Hz."""

    def __init__(self, nodes, probe, sky=ONBOARD, aberration='none'):
        """Show the stars of a sky: by default that of an observer at rest."""
        nodes.start('star_identifier', {'check_period_s': CHECK_NS * 1e-9})
        nodes.start('star_tracker', {'aberration': aberration})
        nodes.start('attitude_estimator', {'aberration': aberration, 'publish_frames': True})
        self.sky = sky
        self.probe = probe
        probe.collect(Imu, 'attitude_imu', qos.LIST)
        probe.collect(DiagnosticStatus, 'tracker_state', qos.STATE)
        probe.collect(DiagnosticArray, 'tracker_status', STATES)
        probe.collect(PointCloud2, 'stars', qos.LIST)
        self.centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST, subscribers=2)
        info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=3)
        probe.publish_until_received(
            info, camera_to_message(CAMERA, make_header(START_NS, FRAME)), nodes=3)
        self.imu = probe.advertise(Imu, 'imu', qos.IMU)
        probe.wait(lambda: all(probe.count_publishers(topic) and probe.count_subscribers(topic)
                               for topic in ('stars', 'tracks', 'tracked_attitude'))
                   and probe.count_subscribers('tracker_state') == 2, 'all nodes')
        # A frame before the others, without stars: from here on no message is the first one.
        early = make_header(START_NS - CHECK_NS, FRAME)
        probe.publish_until_received(self.imu, gyro_to_imu(RATE, 1e-5, early))
        probe.publish_until_received(
            self.centroids, centroids_to_message(Centroids.empty(), CAMERA, early), nodes=2)
        probe.wait(lambda: self.answer_to(START_NS - CHECK_NS), 'the answer to the early frame')
        self.rng = np.random.default_rng(1)
        self.q = quaternion_from_pointing(*np.radians([84.0, 0.0, 20.0]))
        self.index = 0
        self.truth = {}

    def header(self, offset_ns=0, frame_id=FRAME):
        return make_header(START_NS + self.index * STEP_NS + offset_ns, frame_id)

    def answer_to(self, stamp_ns):
        """Return the answer of the estimator to a frame, None before it comes."""
        return next((message for message in reversed(self.probe.received['attitude_imu'])
                     if ns_from_stamp(message.header.stamp) == stamp_ns), None)

    def identified_ns(self):
        """Return the stamps of the frames that were identified, or tried."""
        return [ns_from_stamp(m.header.stamp) for m in self.probe.received['stars']]

    def frames(self, count, measured=RATE, frame_id=FRAME):
        """
        Fly on, frame by frame, and return the answers of the estimator.

        The frame whose identification is due waits for it, so that a slow identifier drops none.
        """
        answers = []
        for _ in range(count):
            stamp_ns = START_NS + self.index * STEP_NS
            for k in range(9, -1, -1):
                if measured is not None:
                    self.imu.publish(gyro_to_imu(
                        np.asarray(measured), 1e-5, self.header(-k * STEP_NS // 10, frame_id)))
            seen, _ = star_list(self.sky, CAMERA, self.q, 0.1, self.rng, false=3)
            self.truth[stamp_ns] = self.q
            # The rates of a frame are there before its stars, as a camera's are.
            self.probe.spin_for(0.02)
            self.centroids.publish(
                centroids_to_message(seen, CAMERA, self.header()))
            answers.append(self.probe.wait(
                lambda stamp_ns=stamp_ns: self.answer_to(stamp_ns), 'an answer'))
            due_ns = stamp_ns - CHECK_NS
            self.probe.wait(lambda due_ns=due_ns: self.identified_ns()
                            and self.identified_ns()[-1] > due_ns, 'the check that is due')
            self.index += 1
            self.q = multiply(self.q, quaternion_from_rotation_vector(RATE * STEP_NS * 1e-9))
        return answers

    def until(self, state, measured=RATE, identification_s=1.0):
        """Fly until the tracker is in a state, so long a frame for its identification."""
        answers = []

        def reached():
            states = self.probe.received['tracker_state']
            return states and states[-1].message == state
        while not reached():
            assert len(answers) < 200, f'{state} is not reached'
            stamp_ns = START_NS + self.index * STEP_NS
            answers += self.frames(1, measured)
            # An identifier that has not yet received LOST leaves frames out.
            deadline_s = time.monotonic() + identification_s
            while not (reached() or stamp_ns in self.identified_ns()
                       or time.monotonic() > deadline_s):
                self.probe.spin_for(0.02)
        return answers

    def errors(self, answers):
        """Return how far the attitudes of the answers are off (N, 3), in sigma of each axis."""
        found = []
        for message in answers:
            tracked = tracked_attitude_from_imu(message)
            if tracked is not None:
                error = attitude_error(tracked.attitude.quaternion,
                                       self.truth[ns_from_stamp(message.header.stamp)])
                found.append(error / np.sqrt(np.diag(tracked.attitude.covariance_sensor)))
        return np.array(found)

    def state(self, key):
        values = {v.key: v.value for v in self.probe.received['tracker_state'][-1].values}
        return values[key]


def test_a_gyro_is_used_and_the_tracks_are_checked(nodes, probe):
    flight = Flight(nodes, probe)
    flight.until('TRACKING')
    tracking_ns = START_NS + flight.index * STEP_NS
    answers = flight.frames(40)
    errors = flight.errors(answers)
    assert len(errors) == 40 and np.abs(errors).max() < 5
    assert flight.state('gyro') == 'used'
    newest_ns = ns_from_stamp(answers[-1].header.stamp)
    status = probe.wait(lambda: [one for one in probe.received['tracker_status'] if ns_from_stamp(
        one.header.stamp) == newest_ns], 'the status of the last frame')[0]
    assert status.header.frame_id == FRAME
    assert [one.message for one in status.status] == ['TRACKING']
    assert {'reason', 'stars_matched', 'gyro'} <= {v.key for v in status.status[0].values}
    tracked = tracked_attitude_from_imu(answers[-1])
    off = (tracked.rate_rad_s - RATE) / np.sqrt(np.diag(tracked.rate_covariance))
    assert np.abs(off).max() < 5 and np.degrees(np.sqrt(tracked.rate_covariance.max())) < 0.02

    # While tracking, one frame a second is identified, and compared with the tracks.
    def steps_ns():
        """Return those between identified frames, once the identifier knows of the tracking."""
        stamps_ns = np.array(flight.identified_ns())
        steps_ns = np.diff(stamps_ns[stamps_ns >= tracking_ns])
        long, = np.nonzero(steps_ns > STEP_NS)
        return steps_ns[long[0]:] if len(long) else long

    while ((len(steps_ns()) < 3 or int(flight.state('checks_passed')) < 3)
           and flight.index < 300):
        flight.frames(5)
    assert int(flight.state('checks_passed')) >= 3
    assert set(steps_ns()) == {CHECK_NS}
    flight.frames(2, frame_id='base_link')
    probe.wait_diagnostic("imu: frame 'base_link' is not that of the centroids")


def test_limits_change_without_loss_of_lock(nodes, probe):
    flight = Flight(nodes, probe)
    flight.until('TRACKING')
    flight.frames(5)
    states = probe.received['tracker_state']
    tracking = len(states)

    def set_parameter(node, name, value):
        """Set a parameter; setting it again has no effect."""
        assert probe.call(SetParameters, f'/{node}/set_parameters', SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])).results[0].successful
    set_parameter('star_tracker', 'max_gap_s', 2.0)
    set_parameter('star_tracker', 'min_stars', 5)
    set_parameter('attitude_estimator', 'min_stars', 100)
    assert all(tracked_attitude_from_imu(answer) is None for answer in flight.frames(3))
    set_parameter('attitude_estimator', 'min_stars', 4)
    errors = flight.errors(flight.frames(10))
    assert len(errors) == 10 and np.abs(errors).max() < 5
    assert {state.message for state in states[tracking:]} == {'TRACKING'}
    # A limit that the frames do not keep has its effect.
    set_parameter('star_tracker', 'min_stars', 100)
    flight.until('LOST', identification_s=0.0)


def test_a_gyro_in_degrees_is_named_and_not_used(nodes, probe):
    flight = Flight(nodes, probe)
    flight.until('TRACKING')
    errors = flight.errors(flight.frames(30, measured=np.degrees(RATE)))
    assert len(errors) == 30 and np.abs(errors).max() < 5
    assert flight.state('gyro') == 'unused'
    probe.wait_diagnostic('is it in rad/s')


def test_a_camera_turned_away_is_lost_and_found(nodes, probe):
    flight = Flight(nodes, probe)
    flight.until('TRACKING')
    assert len(flight.errors(flight.frames(12))) == 12
    flight.q = random_attitude(np.random.default_rng(7))
    answers = flight.frames(1, measured=None)
    answers += flight.frames(14, measured=None)
    assert np.abs(flight.errors(answers)).max() < 5
    assert tracked_attitude_from_imu(answers[0]) is None
    assert tracked_attitude_from_imu(answers[-1]) is not None


def test_an_identifier_works_on_when_its_tracker_has_ended(nodes, probe):
    nodes.start('star_identifier')
    probe.collect(PointCloud2, 'stars', qos.LIST)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, make_header(START_NS, FRAME)))
    state = probe.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
    state.publish(DiagnosticStatus(message='TRACKING'))
    q = quaternion_from_pointing(*np.radians([84.0, 0.0, 20.0]))
    seen, _ = star_list(ONBOARD, CAMERA, q, 0.1, np.random.default_rng(1))

    indices = itertools.count()

    def send():
        """Send a frame, all of them within one period of checks; return its stamp."""
        stamp_ns = START_NS + next(indices) * 1_000_000
        centroids.publish(centroids_to_message(seen, CAMERA, make_header(stamp_ns, FRAME)))
        return stamp_ns

    def identified_ns():
        return {ns_from_stamp(message.header.stamp) for message in probe.received['stars']}
    probe.send_until(
        send, lambda: probe.find_diagnostic('idle while the star tracker tracks')
        and identified_ns(), 'the first check, then a frame that is left out', period_s=0.3)
    left_out_ns = send()
    probe.spin_for(1.0)
    assert left_out_ns not in identified_ns()
    probe.destroy_publisher(state)
    probe.send_until(send, lambda: max(identified_ns()) > left_out_ns, 'another identification',
                     period_s=0.3)


@pytest.mark.parametrize('solver', ['quest', 'triad'])
def test_tracks_alone_are_solved(nodes, probe, solver):
    nodes.start('attitude_estimator', {'solver': solver, 'aberration': 'none'})
    probe.collect(Imu, 'attitude_imu', qos.LIST)
    header = make_header(START_NS, FRAME)
    tracks = probe.advertise(PointCloud2, 'tracks', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.publish_until_received(info, camera_to_message(CAMERA, header))
    q = quaternion_from_pointing(*np.radians([84.0, 0.0, 20.0]))
    seen, hip = star_list(ONBOARD, CAMERA, q, 0.1, np.random.default_rng(3))
    count, zero = len(hip), np.zeros(len(hip))
    tracked = Tracks(
        hip=hip, magnitude=zero, uv=seen.uv, flux=seen.flux, snr=seen.snr,
        sigma_px=seen.sigma_px, residual_px=zero, track_id=np.arange(count, dtype=np.uint32),
        age=zero.astype(np.uint16), missed=zero.astype(np.uint8), association_probability=zero,
        velocity=np.zeros((count, 2)), covariance=np.tile(np.eye(2) * 0.01, (count, 1, 1)))
    stamps_ns = itertools.count(START_NS, STEP_NS)

    def send():
        tracks.publish(tracks_to_message(tracked, CAMERA, make_header(next(stamps_ns), FRAME)))
    answer = probe.send_until(send, lambda: probe.received['attitude_imu'], 'an attitude')[0]
    found = tracked_attitude_from_imu(answer)
    error = attitude_error(found.attitude.quaternion, q)
    assert error @ np.linalg.solve(found.attitude.covariance_sensor, error) < 25
    # Solved from a single frame: no rate is known.
    assert answer.angular_velocity_covariance[0] == -1
    # What nobody asked for is not advertised.
    assert not any(probe.count_publishers(f'attitude_{frame}')
                   for frame in ('j2000', 'itrf', 'orbit', 'body'))
    probe.call(SetParameters, '/attitude_estimator/set_parameters', SetParameters.Request(
        parameters=[Parameter('publish_frames', value=True).to_parameter_msg()]))
    probe.send_until(send, lambda: probe.count_publishers('attitude_itrf'), 'a live parameter')


def seen_by_a_spacecraft(velocity_m_s):
    """Return the catalogue as an observer of geocentric velocity (3,) sees it."""
    observer_state = state_near_earth(epoch_year_from_stamp(START_NS), velocity_m_s)
    return replace(ONBOARD, direction=apparent_directions(ONBOARD.direction, observer_state))


def sigma_arcsec(answer):
    covariance = tracked_attitude_from_imu(answer).attitude.covariance_sensor
    return np.sqrt(np.diag(covariance)) / ARCSEC


def test_odometry_gives_an_attitude_in_icrf(nodes, probe):
    """Without it the covariance contains the orbit; wrong odometry is named and not used."""
    state = State(*CircularOrbit(7.078e6, 0.5, 0.7, 1.0).at(0.0), np.zeros((3, 3)))
    flight = Flight(nodes, probe, seen_by_a_spacecraft(state.velocity_m_s), 'full')
    odometry = probe.advertise(Odometry, 'odometry', qos.LIST, subscribers=2)
    probe.collect(QuaternionStamped, 'attitude_orbit', qos.LIST)
    probe.collect(QuaternionStamped, 'attitude_itrf', qos.LIST)
    flight.until('TRACKING')
    answers = flight.frames(5)
    assert np.abs(flight.errors(answers)).max() < 3
    assert sigma_arcsec(answers[-1])[:2].min() > 3
    probe.wait(lambda: probe.diagnostic_value('attitude_estimator: attitude', 'aberration')
               == 'earth_only (no odometry)', 'the value aberration')
    assert probe.received['attitude_itrf'] and not probe.received['attitude_orbit']

    def send(state, header):
        probe.publish_until_received(
            odometry, state_to_odometry(state, 0.0, header, 'satellite'), nodes=2)
    send(state, flight.header(frame_id='itrf'))
    probe.wait_diagnostic("odometry: frame 'itrf' is not 'icrf'")
    send(state._replace(velocity_m_s=3 * state.velocity_m_s), flight.header(frame_id='icrf'))
    probe.wait_diagnostic('odometry: 22.5 km/s about the Earth')
    send(state, make_header(START_NS - 3 * 3600 * 10 ** 9, 'icrf'))
    assert sigma_arcsec(flight.frames(5)[-1])[:2].min() > 3
    probe.wait_diagnostic('odometry is 3.0 h off')

    send(state, flight.header(frame_id='icrf'))
    answers = flight.frames(30)
    assert len(flight.errors(answers)) == 30 and np.abs(flight.errors(answers)[10:]).max() < 5
    assert sigma_arcsec(answers[-1])[:2].max() < 1
    # The orbit turns the frame by 1.06e-3 rad/s; the sky of this test does not turn with it.
    orbit = probe.received['attitude_orbit'][0]
    stamp_ns = ns_from_stamp(orbit.header.stamp)
    expected = quaternion_from_matrix(
        orbit_frame(state.position_m, state.velocity_m_s).T @ matrix_from_quaternion(
            flight.truth[stamp_ns]))
    error = attitude_error(quaternion_from_message(orbit), expected)
    assert orbit.header.frame_id == 'orbit' and np.linalg.norm(error) < np.radians(0.3)
