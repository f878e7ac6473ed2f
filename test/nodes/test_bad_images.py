# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images and cameras that cannot be right are named by the extractor, which lives on."""

from functools import partial

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, RegionOfInterest, TimeReference
from skies import SMALL_CAMERA as CAMERA, START_NS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, ns_from_stamp, read_cloud
from startracker_ros.ros import qos
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import (
    camera_to_message, exposure_to_message, image_to_message)
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator


def header(index):
    return make_header(START_NS + index * 100_000_000, 'star_tracker_optical_frame')


@pytest.fixture(scope='module')
def sky():
    """One good image of the sky."""
    simulator = SkySimulator(CAMERA, motion_from_options(MotionOptions()),
                             load_catalog().brighter_than(7.0), 2026.7)
    return simulator.frame(0.0).image


class Extractor:
    """A running centroid_extractor with publishers to it."""

    def __init__(self, rig):
        rig.processes.start('centroid_extractor')
        self.probe = probe = rig.probe
        self.index = 0
        probe.collect(PointCloud2, 'centroids')
        self.camera_info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
        self.set_camera(camera_to_message(CAMERA, header(0)))
        self.image = probe.advertise(Image, 'image_raw', qos.IMAGE)
        self.exposure_start = probe.advertise(TimeReference, 'exposure_start', qos.LIST)
        probe.wait(lambda: probe.count_publishers('centroids'), 'centroids offered')

    def set_camera(self, message):
        """Publish a camera_info; between two topics there is no order, so it is counted first."""
        self.probe.publish_until_received(self.camera_info, message)

    def send(self, image, exposure_s=None, **changes):
        """Send an image, changed or not, perhaps after its exposure, and return its stamp."""
        self.index += 1
        if exposure_s is not None:
            self.exposure_start.publish(exposure_to_message(exposure_s, header(self.index)))
        message = image_to_message(image, header(self.index))
        for name, value in changes.items():
            setattr(message, name, value)
        self.image.publish(message)
        return ns_from_stamp(message.header.stamp)

    def send_until_reported(self, image, words, **changes):
        """Send images until a diagnostic has the words."""
        self.probe.send_until(lambda: self.send(image, **changes),
                              lambda: self.probe.find_diagnostic(words), words)

    def still_works(self, sky):
        """Send good images after the bad one: they are answered with stars."""
        self.index += 1
        sent_ns, rng = set(), np.random.default_rng(self.index)
        # Each has noise of its own: an image that is the one before is not used.
        cloud = self.probe.send_until(lambda: sent_ns.add(self.send(
            sky + rng.integers(0, 3, sky.shape, sky.dtype))), lambda: next(
            (c for c in self.probe.received['centroids']
             if ns_from_stamp(c.header.stamp) in sent_ns), None), 'centroids')
        assert cloud.width > 5


@pytest.fixture(scope='module')
def running(shared_rig):
    return Extractor(shared_rig)


@pytest.fixture
def extractor(running):
    """Return the extractor of all tests; what the probe received before the test is deleted."""
    running.probe.forget()
    return running


@pytest.fixture
def probe(extractor):
    return extractor.probe


@pytest.mark.parametrize('changes, words', [
    ({'encoding': 'rgb8'}, 'is too short for 512 x 512 rgb8'),
    ({'encoding': '32FC1'}, "image encoding '32FC1' is not one of mono8, mono16"),
    ({'is_bigendian': 1}, 'the bytes of each value are swapped, as the noise of neighbouring '
     'values says: let the driver set is_bigendian to 0'),
    ({'width': 0, 'height': 0}, 'image size 0 x 0 is empty'),
    ({'height': 4000}, 'is too short for 512 x 4000'),
    ({'width': 500}, 'does not fit camera_info'),
])
def test_image_that_is_invalid(extractor, probe, sky, changes, words):
    extractor.send_until_reported(sky, words, **changes)
    assert not probe.received['centroids']
    extractor.still_works(sky)


def test_an_exposure_that_cannot_be_is_named_and_the_one_before_holds(extractor, probe, sky):
    """Frames are 0.1 s apart."""
    rng = np.random.default_rng(5)

    def are_of(exposure_s):
        """Return whether the newest list of stars has this exposure."""
        clouds = probe.received['centroids'][-1:]
        return all(set(read_cloud(cloud, CENTROID_DTYPE)[name]) == {np.float32(exposure_s)}
                   for cloud in clouds for name in ('exposure_min', 'exposure_max')) and clouds

    def send_until(exposure_s, condition, what):
        probe.send_until(lambda: extractor.send(
            sky + rng.integers(0, 3, sky.shape, sky.dtype), exposure_s), condition, what)

    for exposure_s in (0.04, 0.08):
        send_until(exposure_s, partial(are_of, exposure_s), f'stars exposed for {exposure_s} s')
    for wrong_s, words in ((-0.02, 'the start of the exposure, is not before header.stamp'),
                           (0.4, 'exposure of 0.4 s is longer than the 0.1 s from frame')):
        send_until(wrong_s, partial(probe.find_diagnostic, words), words)
        assert are_of(0.08)


def as_message(image, encoding):
    """Return the message of an image (H, W) uint16 of 12 bits as a driver sends it."""
    grey = (image >> 4).astype(np.uint8)
    pixels = {'rgb8': lambda: np.stack([grey] * 3, -1), 'bgra8': lambda: np.stack([grey] * 4, -1),
              'yuv422': lambda: np.stack([np.full_like(grey, 128), grey], -1),
              'bayer_gbrg8': lambda: grey, 'bayer_rggb16': lambda: image.byteswap(),
              'mono16': lambda: image.byteswap()}[encoding]()
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    # Rows that end with bytes which are not pixels.
    data = np.pad(rows, ((0, 0), (0, 12)), constant_values=77)
    return Image(height=len(image), width=image.shape[1], encoding=encoding,
                 is_bigendian=encoding.endswith('16'), step=data.shape[1], data=data.tobytes())


def test_encodings_of_other_drivers_have_their_stars_where_they_are(extractor, probe, sky):
    """A Bayer mosaic has half as many pixels; its stars are in those of camera_info."""
    rng, places = np.random.default_rng(3), {}
    for encoding in ('mono16', 'rgb8', 'bgra8', 'yuv422', 'bayer_gbrg8', 'bayer_rggb16'):
        sent_ns = set()

        def send(encoding=encoding, sent_ns=sent_ns):
            extractor.index += 1
            message = as_message(sky + rng.integers(0, 3, sky.shape, sky.dtype), encoding)
            message.header = header(extractor.index)
            extractor.image.publish(message)
            sent_ns.add(ns_from_stamp(message.header.stamp))
        cloud = probe.send_until(send, lambda sent_ns=sent_ns: next(
            (c for c in probe.received['centroids']
             if ns_from_stamp(c.header.stamp) in sent_ns), None), encoding)
        rows = read_cloud(cloud, CENTROID_DTYPE)
        places[encoding] = np.stack([rows['u'], rows['v']], -1), rows['sigma_px']
    reference = places.pop('mono16')[0]
    for encoding, (uv, sigma_px) in places.items():
        away = np.linalg.norm(uv[:, None] - reference, axis=-1).min(axis=1)
        same = away < 1.5
        assert np.count_nonzero(same) > 5 and np.mean(same) > 0.6, (encoding, away)
        assert np.median(away[same]) < 0.25 and np.median(sigma_px) < 0.5, (encoding, away)


@pytest.mark.parametrize('changes, words', [
    ({'k': [float('nan')] * 9}, 'NaN or infinity'),
    ({'k': [0.0] * 9, 'p': [0.0] * 12}, 'focal length (0.0, 0.0) px must be positive'),
    ({'k': [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
     'camera_info: field of view above 85 deg to one side of the optical axis'),
    ({'k': [2400.0, 0.0, 0.0, 0.0, 2400.0, 0.0, 0.0, 0.0, 1.0]},
     'camera_info: principal point (0, 0) px is not set'),
    ({'roi': RegionOfInterest(x_offset=400, width=200, height=200)}, 'is not in the image of'),
    ({'distortion_model': 'fisheye'}, "'fisheye' is not one of plumb_bob"),
    ({'width': 0}, 'image size 0 x 512'),
])
def test_camera_info_that_is_invalid(extractor, probe, sky, changes, words):
    info = camera_to_message(CAMERA, header(1))
    for name, value in changes.items():
        setattr(info, name, value)
    extractor.set_camera(info)
    probe.wait_diagnostic(words)
    extractor.send_until_reported(sky, 'no valid camera_info received')
    assert not probe.received['centroids']
    extractor.set_camera(camera_to_message(CAMERA, header(extractor.index)))
    extractor.still_works(sky)


def test_binning_of_the_driver_is_applied(extractor, probe, sky):
    """Its width, height and K are those of the sensor, twice the size of the images."""
    info = camera_to_message(Camera.from_fov(1024, 1024, 12.0), header(extractor.index))
    extractor.set_camera(info)
    extractor.send_until_reported(sky, 'does not fit camera_info of 1024 x 1024 px')
    info.binning_x = info.binning_y = 2
    extractor.set_camera(info)
    extractor.still_works(sky)
    extractor.set_camera(camera_to_message(CAMERA, header(extractor.index)))


@pytest.mark.parametrize('value', [0, 65535])
def test_black_and_white_images_hold_no_star(extractor, probe, sky, value):
    cloud = probe.send_until(lambda: extractor.send(np.full_like(sky, value)),
                             lambda: probe.received['centroids'], 'an empty cloud')[0]
    assert cloud.width == 0
    probe.wait(lambda: any(s.level == b'\x01' and s.message and 'received' not in s.message
                           for s in probe.statuses()
                           if s.name == 'centroid_extractor: centroids'), 'a warning')
    extractor.still_works(sky)


def test_best_effort_publishers_are_named(extractor, probe):
    publisher = probe.create_publisher(
        Image, 'image_raw', QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT))
    probe.wait_diagnostic('nothing is received from best effort publishers: set '
                          'qos_overrides./image_raw.subscription.reliability to best_effort')
    probe.destroy_publisher(publisher)


def test_image_out_of_order_is_counted_and_dropped(extractor, probe, sky):
    extractor.still_works(sky)
    newest = extractor.index
    late_ns = set()

    def send_late():
        extractor.index = newest - 2
        late_ns.add(extractor.send(sky))
    probe.send_until(send_late, lambda: any(v.key == 'image_raw out of order' for s in
                                            probe.statuses() for v in s.values), 'the count')
    assert all(ns_from_stamp(c.header.stamp) not in late_ns
               for c in probe.received['centroids'])
    extractor.index = newest + 1
    extractor.still_works(sky)
