# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A real photograph as industrial drivers publish it: roi, a lens that jitters, a frame_id."""

import csv

import cv2
from geometry_msgs.msg import TransformStamped
import numpy as np
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2, RegionOfInterest
from startracker_ros.core.camera.distortion import RATIONAL
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.io.bags.layouts import SENSOR_FRAME_ID
from startracker_ros.ros import qos
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message

STAGES = ('centroid_extractor', 'star_identifier', 'star_tracker', 'attitude_estimator')
SENSOR = Camera.from_fov(1024, 768, 11.427)
ROI = RegionOfInterest(x_offset=150, y_offset=90, width=800, height=660)
START_NS, FRAME_NS = 1_564_433_246_000_000_000, 200_000_000


class Driver:
    """Publishes a part of a photograph with noise of its own, and camera_info before each."""

    def __init__(self, probe, image):
        self.image = image[ROI.y_offset:ROI.y_offset + ROI.height,
                           ROI.x_offset:ROI.x_offset + ROI.width]
        self.rng = np.random.default_rng(1)
        self.frame_id = 'cam'
        self.index = 0
        self.info = probe.advertise(CameraInfo, 'camera_info', qos.LIST, subscribers=len(STAGES))
        self.images = probe.advertise(Image, 'image_raw', qos.IMAGE)

    def publish(self):
        header = make_header(START_NS + self.index * FRAME_NS, self.frame_id)
        fx, fy = np.array([SENSOR.fx, SENSOR.fy]) * (1 + self.rng.uniform(-1e-7, 1e-7, 2))
        self.info.publish(CameraInfo(
            header=header, width=SENSOR.width, height=SENSOR.height, distortion_model=RATIONAL,
            d=[0.0] * 14, k=[fx, 0.0, SENSOR.cx, 0.0, fy, SENSOR.cy, 0.0, 0.0, 1.0], roi=ROI))
        noise = self.rng.integers(0, 64, self.image.shape, np.uint16)
        self.images.publish(image_to_message(cv2.add(self.image, noise), header))
        self.index += 1


def test_the_attitude_is_that_of_the_sensor_in_the_frame_of_the_images(nodes, probe, sky_data):
    for stage in STAGES:
        nodes.start(stage)
    clouds = ('centroids', 'stars', 'tracks')
    for topic in clouds:
        probe.collect(PointCloud2, topic, qos.LIST)
    for topic in ('tracked_attitude', 'attitude_imu'):
        probe.collect(Imu, topic, qos.LIST)
    probe.collect(TransformStamped, 'attitude_transform', qos.LIST)
    probe.wait(lambda: probe.count_publishers('attitude_transform') and all(
        probe.count_subscribers(topic) for topic in ('centroids', 'stars', 'tracks')), 'the nodes')
    folder = sky_data / 'night-sky-11deg'
    with (folder / 'solutions.csv').open() as file:
        row = next(csv.DictReader(file))
    driver = Driver(probe, cv2.imread(str(folder / row['file']), cv2.IMREAD_UNCHANGED))
    transforms = probe.received['attitude_transform']
    probe.send_until(driver.publish, lambda: len(transforms) >= 5, 'attitudes', period_s=0.2)
    known = np.array([float(row[name]) for name in ('qx', 'qy', 'qz', 'qw')])
    for message in transforms:
        q = message.transform.rotation
        error_deg = np.abs(np.degrees(attitude_error(
            np.array([q.x, q.y, q.z, q.w]), known / np.linalg.norm(known))))
        assert np.hypot(*error_deg[:2]) * 3600 < 60 and error_deg[2] < 0.1
    for topic in (*clouds, 'tracked_attitude', 'attitude_imu'):
        assert {message.header.frame_id for message in probe.received[topic]} == {'cam'}, topic
    assert {(message.header.frame_id, message.child_frame_id) for message in transforms} == {
        ('icrf', 'cam')}
    assert not probe.find_diagnostic('another camera')
    # Another frame, and none.
    for frame_id, words, used in (
            ('other', "frame_id changes from 'cam' to 'other'", 'other'),
            ('', f'image_raw: frame_id is empty, {SENSOR_FRAME_ID} is used', SENSOR_FRAME_ID)):
        driver.frame_id = frame_id
        probe.send_until(driver.publish, lambda used=used, words=words: probe.find_diagnostic(
            words) and transforms[-1].child_frame_id == used, words, period_s=0.2)
    # A gyro without a frame_id is that of a camera without one.
    probe.publish_until_received(
        probe.advertise(Imu, 'imu', qos.IMU), gyro_to_imu(np.zeros(3), 1e-3, make_header(
            START_NS + driver.index * FRAME_NS, '')))
    assert not probe.find_diagnostic('is not that of the centroids')
