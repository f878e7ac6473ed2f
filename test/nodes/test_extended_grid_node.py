# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A narrow field that runs empty: stars by the gyro and the extended grid, on real nodes."""

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
import numpy as np
import pytest
from queues import deep_queues
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import FRAME, NARROW_CAMERA as CAMERA, onboard_stars, START_NS
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, random_attitude
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.io.bags.telemetry import rate_from_imu
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.clouds import centroids_from_message, centroids_to_message
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message

EPOCH_YEAR = 2026.7
OPTIONS = {'method': 'extended_grid', 'magnitude_limit': 7.5}


def identified_hip(cloud):
    hip = read_cloud(cloud, STAR_DTYPE)['hip']
    return hip[hip > 0]


def test_a_rate_survives_its_message():
    rate = np.array([0.01, -0.02, 0.03])
    message = deserialize_message(
        gyro_to_imu(rate, 1e-4, make_header(START_NS, FRAME)), Imu)
    np.testing.assert_array_equal(rate_from_imu(message), rate)
    message.angular_velocity_covariance[0] = -1.0
    with pytest.raises(MessageError, match='imu has no angular velocity'):
        rate_from_imu(message)


def test_attitudes_of_two_and_three_stars(nodes, probe):
    """The field holds ten stars at first, two to three in the second half."""
    frames = 50
    nodes.start('centroid_extractor', deep_queues('image_raw.subscription', 'centroids.publisher'))
    nodes.start('star_identifier', {
        **OPTIONS, **deep_queues('centroids.subscription', 'stars.publisher')})
    nodes.start('attitude_estimator', {
        'source': 'stars', 'min_stars': 2, 'aberration': 'none',
        **deep_queues('stars.subscription', 'attitude.publisher', 'attitude_imu.publisher')})
    for topic, kind in (('attitude_imu', Imu), ('attitude', QuaternionStamped),
                        ('truth/attitude', QuaternionStamped),
                        ('truth/stars', PointCloud2), ('stars', PointCloud2),
                        ('centroids', PointCloud2)):
        probe.collect(kind, topic, qos.LIST)
    probe.wait(lambda: probe.count_publishers('attitude') and probe.count_publishers('stars')
               and probe.count_subscribers('stars') >= 2 and probe.count_subscribers('imu')
               and probe.count_subscribers('camera_info') >= 3, 'the nodes')
    nodes.start('sky_simulator', {
        **deep_queues('image_raw.publisher', 'truth/stars.publisher', 'truth/attitude.publisher'),
        'fov_deg': 4.0, 'faint_limit': 7.5, 'zero_flux_e_s': 1e7, 'frame_rate_hz': 2.0,
        'frame_count': frames, 'wait_for_subscribers': 1, 'wait_for_camera_users': 4,
        'motion': 'constant_rate', 'ra_deg': 317.24, 'dec_deg': -56.04,
        'rate_deg_s': [0.0, 0.2, 0.0]})
    # The simulator begins when the probe, which hears the truth by then, is a user of the camera.
    probe.wait(lambda: probe.count_publishers('truth/stars')
               and probe.count_publishers('truth/attitude'), 'the truth')
    probe.spin_for(0.5)
    probe.collect(CameraInfo, 'camera_info', qos.LIST)
    probe.wait(lambda: min(len(probe.received[topic]) for topic in (
        'stars', 'attitude_imu', 'truth/stars', 'truth/attitude')) >= 0.9 * frames and {
            ns_from_stamp(m.header.stamp) for m in probe.received['stars']} <= {
            ns_from_stamp(m.header.stamp) for m in probe.received['attitude_imu']},
        'nine of ten frames')
    truth = {ns_from_stamp(m.header.stamp): quaternion_from_message(m)
             for m in probe.received['truth/attitude']}
    there = {ns_from_stamp(m.header.stamp): set(identified_hip(m))
             for m in probe.received['truth/stars']}
    found = {ns_from_stamp(m.header.stamp): len(identified_hip(m))
             for m in probe.received['stars']}
    attitude = {ns_from_stamp(m.header.stamp): quaternion_from_message(m)
                for m in probe.received['attitude']}
    assert len(set(there) & set(found)) >= 0.9 * frames
    for message in probe.received['stars']:
        stamp_ns = ns_from_stamp(message.header.stamp)
        assert stamp_ns not in there or set(identified_hip(message)) <= there[stamp_ns]
    for stamp_ns in set(attitude) & set(truth):
        q = attitude[stamp_ns]
        error = np.abs(attitude_error(q, truth[stamp_ns])) / ARCSEC
        assert np.hypot(error[0], error[1]) < 20 and error[2] < 1200
    poor = [m for m in probe.received['centroids'] if m.width in (2, 3)]
    stamps = {ns_from_stamp(m.header.stamp) for m in poor}
    assert len(stamps) >= 15
    solved = stamps & set(attitude)
    assert len(solved) >= 0.9 * len(stamps), sorted(found.values())
    for method in ('pyramid', 'quad'):
        identifier = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
            method=method, magnitude_limit=7.5))
        assert all(identifier.identify(centroids_from_message(m)).attitude is None
                   for m in poor)


class Sky:
    """A running star_identifier with centroids and rates of a sensor that stands still."""

    def __init__(self, nodes, probe):
        nodes.start('star_identifier', OPTIONS)
        self.probe = probe
        self.index = 0
        probe.collect(PointCloud2, 'stars', qos.LIST)
        self.centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
        self.info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
        probe.publish_until_received(self.info, camera_to_message(CAMERA, self.header()))
        self.imu = probe.advertise(Imu, 'imu', qos.LIST)
        probe.wait(lambda: probe.count_publishers('stars'), 'stars offered')
        onboard = onboard_stars(CAMERA, EPOCH_YEAR, 7.5)
        rng = np.random.default_rng(2)
        self.stars = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)[0]
        assert len(self.stars) >= 8

    def header(self, frame_id=FRAME):
        return make_header(START_NS + self.index * 100_000_000, frame_id)

    def rate(self, rate=(0.0, 0.0, 0.0), frame_id=FRAME):
        """Send a rate; between two topics there is no order, so it is counted first."""
        self.probe.publish_until_received(
            self.imu, gyro_to_imu(np.array(rate), 1e-6, self.header(frame_id)))

    def frame(self, count):
        """Send the brightest stars and return how many are identified."""
        header = self.header()
        message = centroids_to_message(self.stars.select(slice(count)), CAMERA, header)
        before = len(self.probe.received['stars'])
        cloud = self.probe.send_until(
            lambda: self.centroids.publish(message), lambda: next(
                (cloud for cloud in self.probe.received['stars'][before:]
                 if cloud.header.stamp == header.stamp), None), 'an answer')
        self.index += 1
        return len(identified_hip(cloud))


@pytest.fixture
def sky(nodes, probe):
    return Sky(nodes, probe)


def test_without_imu_the_pyramid_alone(sky, probe):
    assert sky.frame(12) >= 4
    probe.wait_diagnostic('no imu: identifying lost-in-space only')
    assert sky.frame(2) == 0
    probe.wait_diagnostic('2 usable stars')
    assert any(v.key == 'prediction' and v.value == 'no imu, lost in space'
               for status in probe.statuses() for v in status.values)


def test_imu_that_cannot_be_right(sky, probe):
    """Each is named; the prediction goes on without it and ends when it has aged."""
    sky.rate()
    assert sky.frame(12) >= 4
    sky.rate()
    assert sky.frame(2) == 2
    sky.rate((np.nan, 0.0, 0.0))
    probe.wait_diagnostic('imu: angular velocity [nan, 0.0, 0.0] rad/s cannot be right')
    sky.rate((0.0, 1e3, 0.0), 'imu_link')
    probe.wait_diagnostic("frame 'imu_link' is not that of the centroids")
    sky.index += 1
    sky.rate((0.0, 1e3, 0.0))
    probe.wait_diagnostic('imu: angular velocity [0.0, 1000.0, 0.0] rad/s cannot be right')
    assert sky.frame(3) == 3
    sky.index += 50
    assert sky.frame(3) == 0
    assert sky.frame(12) >= 4
    sky.rate()
    assert sky.frame(2) == 2


def test_a_jump_back_in_time_forgets_the_attitude(sky, probe):
    """And it does not rest: the star tracker says that it is tracking all the time."""
    state = probe.advertise(DiagnosticStatus, 'tracker_state', qos.STATE)
    probe.publish_until_received(state, DiagnosticStatus(message='TRACKING'))
    sky.index = 100
    sky.rate()
    assert sky.frame(12) >= 4
    sky.rate()
    assert sky.frame(2) == 2
    sky.index = 1
    sky.rate()
    assert sky.frame(2) == 0
    assert sky.frame(12) >= 4
    sky.rate()
    assert sky.frame(2) == 2
