# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fisheyes that calibrate has measured: the nodes and startracker live with their camera files."""

from pathlib import Path
import time
from typing import NamedTuple

import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from queues import deep_queues
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.io.bags.layouts import (
    camera_from_message, CENTROID_DTYPE, ns_from_stamp, read_cloud)
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.io.images.capture import CaptureOptions
from startracker_ros.photographs.calibrate import calibrate_files
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)
from startracker_ros.ros.messages.clouds import tracks_from_message
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.demos.live_demo import read_stamped
from startracker_ros.tools.live.live import run_live

# Of 176 deg, off centre: 2 tan(theta / 2), and sin(theta) with its circle inside the image.
LENSES = {
    'stereographic': Camera(1024, 1024, 280.0, 280.0, 545.0, 480.0,
                            (1 / 12, 1 / 120, 17 / 20160, 31 / 362880), 'equidistant'),
    'orthographic': Camera(1024, 1024, 480.0, 480.0, 545.0, 480.0,
                           (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880), 'equidistant')}
FRAMES, RATE_HZ = 30, 2.0
FRAME_NS = round(1e9 / RATE_HZ)
# A pixel is 0.1 to 0.2 deg.
MOTION = motion_from_options(MotionOptions(motion='constant_rate', rate_deg_s=(0.1, 0.3, 0.05)))
EPOCH_YEAR = time.time() / 31557600 + 1970


# Of lamps in the corners, outside the circle of the second lens.
LAMPS = [(30, 40), (990, 35), (60, 985)]


def picture(simulator, time_s):
    """Return the image of a time, with lamps."""
    image = simulator.frame(time_s).image
    most, sigma_px = np.iinfo(image.dtype).max, DetectorOptions().psf_sigma_px
    lamps = np.zeros(image.shape, np.float32)
    lamps[tuple(np.transpose(LAMPS))] = 0.3 * most * 2 * np.pi * sigma_px ** 2
    lit = image + cv2.GaussianBlur(lamps, (0, 0), sigma_px)
    return lit.clip(0, most).astype(image.dtype)


class Night(NamedTuple):
    """Images of a lens, and what calibrate has made of two others of the night."""

    lens: Camera
    images: Path
    camera_file: Path


@pytest.fixture(scope='module')
def night(request, tmp_path_factory):
    lens, folder = LENSES[request.param], tmp_path_factory.mktemp(request.param)
    simulator = SkySimulator(lens, MOTION, load_catalog().brighter_than(5.5), EPOCH_YEAR,
                             frame_rate_hz=RATE_HZ, seed=1)
    images, before = folder / 'images', [folder / f'before{k}.png' for k in range(2)]
    images.mkdir()
    for path, time_s in zip(before, (100.0, 900.0)):
        cv2.imwrite(str(path), picture(simulator, time_s))
    for number in range(FRAMES):
        cv2.imwrite(str(images / f'{number:03d}.png'), picture(simulator, number / RATE_HZ))
    calibrate_files(before, folder / 'camera.yaml', epoch_year=EPOCH_YEAR,
                    distortion_model='equidistant')
    return Night(lens, images, folder / 'camera.yaml')


def errors_px(night, messages, begin_ns):
    """Return how far attitudes (N,) are off in pixels, the first image of begin_ns."""
    errors = [attitude_error(
        quaternion_from_message(message), MOTION.at(
            (ns_from_stamp(message.header.stamp) - begin_ns) * 1e-9).q_icrf_from_sensor)
        for message in messages]
    return np.linalg.norm(errors, axis=1) / night.lens.pixel_rad


@pytest.mark.parametrize('night', [
    'orthographic', pytest.param('stereographic', marks=pytest.mark.long)], indirect=True)
def test_the_nodes_track_the_sky_of_a_fisheye(nodes, probe, night):
    nodes.start('centroid_extractor', deep_queues('image_raw.subscription', 'centroids.publisher'))
    nodes.start('star_identifier', deep_queues('centroids.subscription', 'stars.publisher'))
    nodes.start('star_tracker', deep_queues('centroids.subscription', 'stars.subscription',
                                            'tracks.publisher', 'tracked_attitude.publisher'))
    nodes.start('attitude_estimator', deep_queues('tracks.subscription',
                                                  'tracked_attitude.subscription'))
    for kind, topic in ((QuaternionStamped, 'attitude'), (Imu, 'attitude_imu'),
                        (PointCloud2, 'centroids'), (PointCloud2, 'tracks'),
                        (CameraInfo, 'camera_info')):
        probe.collect(kind, topic, qos.LIST)
    probe.collect(DiagnosticStatus, 'tracker_state', qos.STATE)
    probe.wait(lambda: all(map(probe.count_publishers, ('attitude', 'tracks', 'stars'))),
               'the nodes')
    nodes.start('image_publisher', {
        **deep_queues('image_raw.publisher'), 'path': str(night.images),
        'camera_file': str(night.camera_file), 'frame_rate_hz': RATE_HZ, 'frames_ahead': 1,
        'wait_for_subscribers': 1, 'wait_for_camera_users': 4})

    def answers():
        return {ns_from_stamp(answer.header.stamp): answer
                for answer in probe.received['attitude_imu']}
    probe.wait(lambda: len(answers()) == FRAMES, 'an answer to each image')
    assert probe.received['tracker_state'][-1].message == 'TRACKING'
    assert (camera := camera_from_message(probe.received['camera_info'][-1])) == load_camera(
        night.camera_file)
    found = {stamp_ns: tracked_attitude_from_imu(answer)
             for stamp_ns, answer in answers().items()}
    begin_ns = min(found)
    trusted = [stamp_ns for stamp_ns, answer in found.items() if answer is not None]
    assert sorted(found)[-FRAMES // 2:] == sorted(trusted)[-FRAMES // 2:]
    assert set(trusted) == {ns_from_stamp(one.header.stamp) for one in probe.received['attitude']}
    assert errors_px(night, probe.received['attitude'], begin_ns).max() < 0.1
    # The lamps are seen; outside the image circle they have no direction.
    spots = read_cloud(probe.received['centroids'][0], CENTROID_DTYPE)
    for row, column in LAMPS:
        near = np.hypot(spots['u'] - column, spots['v'] - row) < 1
        assert near.any()
        assert np.isnan(spots['x'][near]).all() == np.isnan(
            camera.unproject([column, row])).any()
    # Tracked stars are all over the image.
    direction = camera.unproject(tracks_from_message(probe.received['tracks'][-1]).uv)
    assert len(direction) > 20 and direction[:, 2].min() < np.cos(np.radians(65))


@pytest.mark.parametrize('night', [
    'stereographic', pytest.param('orthographic', marks=pytest.mark.long)], indirect=True)
def test_live_tracks_the_sky_of_a_fisheye_known_or_not(night, tmp_path):
    """The lens of the second one is estimated from its first image, given nothing."""
    known = night.camera_file if night.lens is LENSES['stereographic'] else None
    result = run_live(tmp_path, CaptureOptions(device=str(night.images), frame_rate_hz=RATE_HZ),
                      camera_file=known, record=True, seconds=HANGS_S)
    row, = result.rows
    assert row['state'] == 'TRACKING' and row['frames_tracking'] >= 5
    assert load_camera(result.conditions['camera_file']).distortion_model == 'equidistant'
    stamped = list(read_stamped(next(tmp_path.glob('bag_*')), ('/image_raw', '/attitude')))
    # Recording begins a little after the first image.
    last_ns = max(stamp_ns for record, stamp_ns, _ in stamped if record.topic == '/image_raw')
    attitudes = [message for record, _, message in stamped if record.topic == '/attitude']
    errors = errors_px(night, attitudes, last_ns - (FRAMES - 1) * FRAME_NS)
    # The principal point of a single image is less certain.
    assert len(errors) >= 5 and errors.max() < (0.1 if known else 0.3)
