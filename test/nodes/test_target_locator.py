# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A real target_locator between two observers that a test plays."""

import subprocess

from geometry_msgs.msg import PoseWithCovarianceStamped
from limits import HANGS_S
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, PointCloud2
from skies import CAMERA, START_NS
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import ARCSEC, quaternion_from_matrix
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.messages.odometry import motion_to_odometry
from startracker_ros.ros.processes import node_command, node_environment, parameter_arguments
from visualization_msgs.msg import MarkerArray

TARGET = np.array([7.45e6, 2.1e5, 3e4])
ONBOARD = np.array([[7.07e6, 0.0, 0.0], [7.05e6, 4.9e5, 1e3]])
VELOCITY = np.array([0.0, 7.5e3, 0.0])


def towards(place, target=TARGET):
    """Return the attitude of a camera that looks straight at the target."""
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return quaternion_from_matrix(np.stack([x, np.cross(z, x), z], -1))


class Observers:
    """Publishers of both, and what each says unless a test says otherwise."""

    def __init__(self, probe):
        self.probe = probe
        self.index = 0
        self.topics = [{
            topic: probe.advertise(kind, f'tracker_{number}/{topic}', qos.LIST)
            for topic, kind in (('camera_info', CameraInfo), ('odometry', Odometry),
                                ('attitude_cov', PoseWithCovarianceStamped),
                                ('target_centroid', PointCloud2))} for number in (1, 2)]

    def frame(self, which, place=None, quaternion=None, *, later_s=0.0, covariance=ARCSEC ** 2,
              frame_id='icrf', uv=(511.5, 511.5), sigma_px=0.1):
        """Publish all that one observer says about the present frame; return its stamp."""
        place = ONBOARD[which] if place is None else place
        quaternion = towards(ONBOARD[which]) if quaternion is None else quaternion
        stamp_ns = START_NS + self.index * 500_000_000 + round(later_s * 1e9)
        sensor = make_header(stamp_ns, 'star_tracker_optical_frame')
        inertial = make_header(stamp_ns, frame_id)
        attitude = PoseWithCovarianceStamped(header=inertial)
        q = attitude.pose.pose.orientation
        q.x, q.y, q.z, q.w = map(float, quaternion)
        attitude.pose.covariance = np.diag([0.0] * 3 + [covariance] * 3).ravel()
        topics = self.topics[which]
        topics['camera_info'].publish(camera_to_message(CAMERA, sensor))
        topics['odometry'].publish(motion_to_odometry(
            place, VELOCITY, towards(ONBOARD[which]), np.zeros(3), inertial, sensor.frame_id))
        topics['attitude_cov'].publish(attitude)
        topics['target_centroid'].publish(centroids_to_message(Centroids(
            np.array([uv]), np.array([1e4]), np.array([50.0]), np.array([sigma_px])),
            CAMERA, sensor))
        return stamp_ns

    def frames_until(self, condition, what, **second):
        """Publish frames of both, the second as given, until condition(stamps) is true."""
        stamps_ns = set()

        def send():
            self.index += 1
            stamps_ns.add(self.frame(0))
            self.frame(1, **second)
        return self.probe.send_until(send, lambda: condition(stamps_ns), what)

    def answer_to(self, stamps_ns):
        """Return a position published for one of the stamps, None without one."""
        return next((m for m in self.probe.received['target/position']
                     if ns_from_stamp(m.header.stamp) in stamps_ns), None)

    def located(self):
        """Publish frames of both until a position is published for one of them."""
        return self.frames_until(self.answer_to, 'a position')

    def refused(self, words, **second):
        """Publish frames, the second as given: the reason is named, no position is published."""
        def named(stamps_ns):
            assert self.answer_to(stamps_ns) is None
            return self.probe.find_diagnostic(words)
        self.frames_until(named, words, **second)


@pytest.fixture
def observers(nodes, probe):
    nodes.start('target_locator', {'aberration': 'none'})
    probe.collect(PoseWithCovarianceStamped, 'target/position')
    probe.collect(MarkerArray, 'target/line_of_sight')
    observers = Observers(probe)
    probe.wait(lambda: probe.count_publishers('target/line_of_sight'), 'target offered')
    return observers


def test_target_is_located_and_bad_input_is_named(observers):
    probe = observers.probe
    probe.wait_diagnostic('tracker_1: no camera_info; tracker_2: no camera_info')
    message = observers.located()
    assert message.header.frame_id == 'icrf'
    place = message.pose.pose.position
    assert np.linalg.norm([place.x, place.y, place.z] - TARGET) < 1e-2
    covariance = np.reshape(message.pose.covariance, (6, 6))
    assert 5 < np.sqrt(np.trace(covariance)) < 50 and not covariance[3:].any()
    markers = probe.wait(lambda: probe.received['target/line_of_sight'], 'lines of sight')
    first, second, ellipsoid = markers[0].markers
    for line, start in ((first, ONBOARD[0]), (second, ONBOARD[1])):
        ends = np.array([[point.x, point.y, point.z] for point in line.points])
        np.testing.assert_allclose(ends, [start, TARGET], atol=1e-2)
    assert {first.header.frame_id, second.header.frame_id, ellipsoid.header.frame_id} == {'icrf'}
    assert ellipsoid.scale.x <= ellipsoid.scale.y <= ellipsoid.scale.z

    nan = float('nan')
    observers.refused('parallel', quaternion=towards(ONBOARD[0]))
    observers.refused('behind the second observer',
                      quaternion=towards(ONBOARD[1], 2 * ONBOARD[1] - TARGET))
    observers.refused('observers 0 m apart', place=ONBOARD[0])
    observers.refused('do not point to one target', uv=(711.5, 511.5))
    observers.refused(
        'orientation [0.0, 0.0, 0.0, 0.0] is not an attitude', quaternion=np.zeros(4))
    observers.refused('orientation [nan', quaternion=np.full(4, nan))
    observers.refused('is not positive', covariance=0.0)
    observers.refused("frame 'map' is not 'icrf'", frame_id='map')
    observers.refused('position, velocity or their covariance is not finite',
                      place=np.array([nan, 0, 0]))
    observers.refused('cloud field', uv=(nan, 511.5))
    observers.refused('sigma_px nan is not positive', sigma_px=nan)
    observers.refused('its clock apart, for 100.0 s', later_s=100.0)

    # One falls silent: what may still come is waited for, then it is named.
    def first_alone():
        observers.index += 250
        observers.frame(0)
    words = 'tracker_2: odometry silent, or its clock apart, for'
    probe.forget()
    probe.send_until(first_alone, lambda: probe.find_diagnostic(words), words)
    # And all is well again.
    observers.located()
    probe.wait(lambda: probe.statuses()[-1].level != b'\x02', 'a status without an error')


def test_two_names_for_one_observer_stop_the_node():
    """At the start, with the name in the message."""
    done = subprocess.run(
        node_command('target_locator', parameter_arguments({'observer_2': 'tracker_1'})),
        env=node_environment(), capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 2
    assert "observer_1 and observer_2 are both 'tracker_1'" in done.stderr
