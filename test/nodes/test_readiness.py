# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node is ready once it is active, set up for the camera, and connected."""

from sensor_msgs.msg import CameraInfo, PointCloud2
from startracker_ros.core.camera.model import Camera
from startracker_ros.ros import qos
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.tools.demos.readiness import needs_of, Readiness


def test_readiness(nodes, probe):
    needs = needs_of(('star_tracker', 'bag_player'), 'head')
    assert list(needs) == ['/head/star_tracker', '/head/bag_player']
    readiness = Readiness(probe, needs_of(('star_tracker',), 'head'))
    publisher = probe.create_publisher(CameraInfo, '/head/camera_info', qos.LIST)
    nodes.start('star_tracker', {'magnitude_limit': 5.0}, namespace='head')

    def condition(*messages: CameraInfo) -> str:
        # Repeated, as a camera repeats it.
        for message in messages:
            publisher.publish(message)
        readiness.update()
        return readiness.conditions()['/head/star_tracker']
    assert condition() == 'starting'
    probe.wait(lambda: condition() == 'waiting for a publisher of centroids', 'the code')
    assert publisher.get_subscription_count() == 0, 'no user before its frames can come'
    probe.create_publisher(PointCloud2, '/head/centroids', qos.LIST)
    probe.wait(lambda: condition() == 'waiting for camera_info', 'the link')
    camera = camera_to_message(Camera.from_fov(256, 256, 12.0), make_header(
        1_790_000_000_000_000_000, 'camera'))
    probe.wait(lambda: condition(camera) == 'waiting for connections', 'the camera')
    readiness.connected()
    probe.wait(lambda: condition() == '', 'the answer to a request sent since then')
