# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The system of the JPDAF paper by its parameter file: nodes over DDS equal to the core."""

from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from skies import CAMERA, FRAME, onboard_stars, START_NS
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.observer_motion import AberrationOptions, ObserverMotion
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.rotation import (
    attitude_error, multiply, quaternion_from_pointing, quaternion_from_rotation_vector)
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.io.bags.telemetry import rate_from_imu
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.clouds import (
    centroids_from_message, centroids_to_message, stars_to_message)
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.messages.serialized import deserialized
import yaml

FILE = Path(__file__).parents[2] / 'config' / 'paper_jpdaf.yaml'
ONBOARD = onboard_stars(CAMERA, 2026.7, 6.5)
STEP_NS = 100_000_000
FRAMES = 25
STATES = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Frame:
    """The messages of one frame: centroids, their stars, and the rate since the one before."""

    def __init__(self, stamp_ns, q, rate, rng):
        header = make_header(stamp_ns, FRAME)
        seen, hip = star_list(ONBOARD, CAMERA, q, 0.1, rng, false=3)
        self.stamp_ns = stamp_ns
        self.centroids = centroids_to_message(seen, CAMERA, header)
        self.stars = stars_to_message(
            seen, hip, np.zeros(len(hip)), np.zeros(len(hip)), CAMERA, header)
        self.imu = gyro_to_imu(rate, 1e-5, header)


def frames():
    """Return frames under a steady turn with a jitter of the roll rate, new every fifth one."""
    rng = np.random.default_rng(2)
    q, result = quaternion_from_pointing(*np.radians([84.0, 0.0, 20.0])), []
    for k in range(FRAMES):
        if k % 5 == 0:
            rate = np.radians([0.0, 0.06, rng.uniform(-0.5, 0.5)])
        q = multiply(q, quaternion_from_rotation_vector(rate * STEP_NS * 1e-9))
        result.append(Frame(START_NS + k * STEP_NS, q, rate, rng))
    return result


def options():
    return TrackerOptions(**yaml.safe_load(FILE.read_text())['/**/star_tracker'][
        'ros__parameters'])


def by_the_core(sent, chosen):
    """Return the quaternion of each frame of the messages by the core, None where it has none."""
    tracker = make_track_filter(
        CAMERA, epoch_year_from_stamp(START_NS), chosen, motion=ObserverMotion(
            AberrationOptions(aberration='none')))
    for frame in sent:
        tracker.add_rate(frame.stamp_ns, rate_from_imu(deserialized(frame.imu, Imu)))
    found = []
    for k, frame in enumerate(sent):
        tracker.update(frame.stamp_ns, centroids_from_message(
            deserialized(frame.centroids, PointCloud2)))
        if k < 2:
            rows = read_cloud(deserialized(frame.stars, PointCloud2), STAR_DTYPE)
            tracker.identified(frame.stamp_ns, centroids_from_rows(rows), rows['hip'])
        found.append(None if tracker.attitude is None or k < 2
                     else tracker.attitude.attitude.quaternion)
    return found


def by_the_nodes(sent, nodes, probe):
    """Return the same of the nodes with the parameter file, and a function that sends more."""
    for node in ('star_tracker', 'attitude_estimator'):
        nodes.start(node, {'aberration': 'none'}, ['--params-file', str(FILE)])
    probe.collect(Imu, 'attitude_imu', qos.LIST)
    probe.collect(DiagnosticStatus, 'tracker_state', STATES)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=2)
    probe.publish_until_received(
        info, camera_to_message(CAMERA, make_header(START_NS, FRAME)), nodes=2)
    imu = probe.advertise(Imu, 'imu', qos.IMU)
    stars = probe.advertise(PointCloud2, 'stars', qos.LIST)
    probe.wait(lambda: all(probe.count_publishers(topic) and probe.count_subscribers(topic)
                           for topic in ('tracks', 'tracked_attitude')), 'both nodes')

    def answer_to(frame):
        return next((message for message in probe.received['attitude_imu']
                     if ns_from_stamp(message.header.stamp) == frame.stamp_ns), None)

    def send(frame):
        """Send a frame until it is answered: a stamp that is known is left out."""
        return probe.send_until(lambda: centroids.publish(frame.centroids),
                                lambda: answer_to(frame), 'an answer')

    probe.publish_until_received(
        imu, gyro_to_imu(np.zeros(3), 1e-5, make_header(START_NS - 10 ** 9, FRAME)))
    for frame in sent:
        imu.publish(frame.imu)
    probe.wait(lambda: int(probe.diagnostic_value('star_tracker: tracking', 'imu received'))
               > len(sent), 'all rates')
    found = []
    for frame, state in zip(sent, ['ACQUIRING', 'TRACKING'] + [''] * len(sent)):
        attitude = tracked_attitude_from_imu(send(frame))
        found.append(None if attitude is None else attitude.attitude.quaternion)
        if state:
            probe.send_until(
                lambda frame=frame: stars.publish(frame.stars),
                lambda state=state: probe.received['tracker_state'][-1].message == state, state)
    return found, send


def largest_difference(one, other):
    """Return the largest angle in rad between attitudes of the frames that have both."""
    return max(np.linalg.norm(attitude_error(a, b)) for a, b in zip(one, other)
               if a is not None and b is not None)


def test_the_paper_by_parameters_alone(nodes, probe):
    *sent, extra = frames()
    chosen = options()
    assert (chosen.solver, chosen.max_stars, chosen.sna_confirmation) == ('triad', 4, True)
    core = by_the_core(sent, chosen)
    assert sum(q is not None for q in core) == len(sent) - 2
    found, send = by_the_nodes(sent, nodes, probe)
    assert [q is None for q in found] == [q is None for q in core]
    assert largest_difference(found, core) < 1e-12
    # Another solver, or a filter that ignores the gyro, would have shown.
    assert largest_difference(found, by_the_core(sent, replace(chosen, solver='quest'))) > 1e-6
    assert largest_difference(
        found, by_the_core(sent, replace(chosen, roll_by_gyro=False))) > 1e-6

    def set_parameter(node, name, value):
        return probe.call(SetParameters, f'/{node}/set_parameters', SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])).results[0]
    refused = set_parameter('star_tracker', 'model', 'attitude')
    assert not refused.successful and 'has no effect with model' in refused.reason
    assert set_parameter('attitude_estimator', 'solver', 'svd').successful
    send(extra)
    probe.wait_diagnostic('attitude_estimator.solver = svd has no effect')
    assert set_parameter('star_tracker', 'roll_by_gyro', False).successful
    assert set_parameter('star_tracker', 'gyro_drift_deg_h', 7.0).successful
    probe.wait_diagnostic('no effect with model = constant_velocity: gyro_drift_deg_h')
