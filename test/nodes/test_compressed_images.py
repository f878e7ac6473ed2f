# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera whose images are compressed, from its files to the centroids."""

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, PointCloud2
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud
from startracker_ros.ros import qos
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

COMPRESSED = {'image_transport': 'compressed'}


def test_compressed_images_give_the_centroids_of_the_files(nodes, probe, tmp_path):
    camera = Camera.from_fov(256, 256, 20.0)
    image = SkySimulator(camera, motion_from_options(MotionOptions()),
                         load_catalog().brighter_than(6.5), 2026.7).frame(0.0).image
    assert image.dtype == np.uint16
    cv2.imwrite(str(tmp_path / 'stars.png'), image)
    probe.collect(CompressedImage, 'image_raw/compressed', qos.IMAGE)
    probe.collect(PointCloud2, 'centroids', qos.LIST)
    images, clouds = probe.received['image_raw/compressed'], probe.received['centroids']
    nodes.start('centroid_extractor', COMPRESSED)
    nodes.start('image_publisher', {
        **COMPRESSED, 'path': str(tmp_path / 'stars.png'), 'loop': True, 'fov_deg': 20.0,
        'frame_rate_hz': 5.0, 'wait_for_subscribers': 2})
    probe.wait(lambda: len(clouds) >= 2 and len(images) >= 2, 'centroids')
    assert images[0].format == 'mono16; png compressed '
    expected = CentroidExtractor().measure(image).centroids
    rows = read_cloud(clouds[0], CENTROID_DTYPE)
    assert len(rows) == len(expected) > 5
    np.testing.assert_allclose(rows['u'], expected.uv[:, 0], atol=1e-4)
    stamp = clouds[-1].header.stamp
    probe.wait(lambda: any(message.header.stamp == stamp for message in images), 'its image')
    assert not probe.count_publishers('image_raw')
    # Another source, whose images are damaged.
    publisher = probe.advertise(CompressedImage, 'image_raw/compressed', qos.IMAGE, subscribers=2)
    damaged = images[0]
    damaged.data[len(damaged.data) // 2] ^= 1
    words = 'image_raw/compressed: compressed image is damaged at byte'
    probe.send_until(lambda: publisher.publish(damaged), lambda: probe.find_diagnostic(words),
                     words)
    count = len(clouds)
    probe.wait(lambda: len(clouds) > count, 'the next centroids')
