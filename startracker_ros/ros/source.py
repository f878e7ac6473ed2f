# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the nodes that publish images share: camera, messages, frame rate and stamps."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial

import numpy as np
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, Imu
from sensor_msgs.srv import SetCameraInfo
from startracker_ros.core.astro.epoch import stamp_from_datetime
from startracker_ros.core.camera.calibrated import check_sensor
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import camera_from_message, ns_from_stamp
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import WARN
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.image_topic import ImageOutput
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.node import PipelineNode, StartError
from std_msgs.msg import Header


ANSWER_LIMIT_S = 30.0
"""What has not been answered for so long is lost: the next image goes out."""


@dataclass(frozen=True)
class SourceOptions(Options):
    """Rate and stamps of the published images."""

    frame_rate_hz: float = option(10.0, 'images a second', unit='Hz', low=0.01, high=1000.0)
    frame_count: int = option(0, 'images to publish, 0 for no end', low=0)
    wait_for_subscribers: int = option(
        0, 'subscribers of the images to wait for before the first image', low=0, high=100)
    wait_for_camera_users: int = option(
        0, 'subscribers of camera_info to wait for before the first image, and one of the images: '
        'every stage of the pipeline is one once it has loaded its code and found the stage '
        'before it, so that no first image is lost', low=0, high=100)
    frames_ahead: int = option(
        0, 'images that may be ahead of the messages of answer_topics: the next one waits, for '
        '30 s at most, so that a busy machine loses no frame and is slower than frame_rate_hz; 0 '
        'for no limit', low=0, high=1000)
    answer_topics: tuple[str, ...] = option(
        ('attitude_imu',), 'topics (sensor_msgs/Imu) with a message for each image, for '
        'frames_ahead', read_only=True)
    start_time_utc: str = option(
        '', 'stamp of the first image, as 2019-07-29T20:47:26; empty for now', read_only=True)

    def start_ns(self) -> int | None:
        """Return the stamp of the first image in ns since the UNIX epoch, None for now."""
        if not self.start_time_utc:
            return None
        try:
            moment = datetime.fromisoformat(self.start_time_utc)
        except ValueError as error:
            raise StartError(f'start_time_utc = {self.start_time_utc!r} is not an ISO 8601 '
                             'time like 2019-07-29T20:47:26') from error
        return stamp_from_datetime(moment)


@dataclass(frozen=True)
class CameraOptions(Options):
    """The camera, out of a calibration file or ideal."""

    camera_file: str = option(
        '', 'camera YAML as camera_calibration writes it, or FITS header with SIP; empty for an '
        'ideal camera')
    fov_deg: float = option(12.0, 'horizontal field of view of the ideal camera, edge to edge',
                            unit='deg', low=0.5, high=90.0)

    def file_camera(self) -> Camera | None:
        """Return the camera of the file, None without; CameraError if no node would take it."""
        if not self.camera_file:
            return None
        camera = load_camera(self.camera_file)
        check_sensor(camera)
        return camera

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera of the file, or an ideal one of width x height px."""
        return self.file_camera() or Camera.from_fov(width, height, self.fov_deg)


class ImageSourceNode(PipelineNode):
    """
    Publishes images and the camera that took them.

    set_camera_info replaces the camera of the parameters until these have another, as
    camera_info_manager does; it is not written to camera_file.
    """

    sends_images = True

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._published_camera: Camera | None = None
        self._own_camera: Camera | None = None
        self._replaced: tuple[Camera, Camera] | None = None
        self._image = ImageOutput(self)
        self._camera_info = self.advertise(CameraInfo, 'camera_info', qos.LIST)
        self.create_service(SetCameraInfo, 'set_camera_info', self._on_set_camera_info)

    def publish_image(self, image: np.ndarray, camera: Camera, header: Header) -> None:
        """Publish an image (H, W) and the camera that took it."""
        # As in image_transport, the image goes first: camera_info wakes all nodes, which would
        # delay the image. Only a new camera goes before its first image.
        calibrated = self._calibrated(camera)
        same = calibrated.is_same(self._published_camera)
        self._published_camera = calibrated
        if not same:
            self._publish_camera_info(camera, header)
        self._image.publish(image, header)
        if same:
            self._publish_camera_info(camera, header)
        self.diagnostics.counts['frames'] += 1

    def _publish_camera_info(self, camera: Camera, header: Header) -> None:
        self._own_camera = camera
        self._camera_info.publish(camera_to_message(self._calibrated(camera), header))

    def _calibrated(self, camera: Camera) -> Camera:
        """Return the camera that was set in the place of this one, or this one."""
        if self._replaced is not None and self._replaced[0].is_same(camera):
            return self._replaced[1]
        return camera

    def _on_set_camera_info(self, request: SetCameraInfo.Request,
                            response: SetCameraInfo.Response) -> SetCameraInfo.Response:
        own = self._own_camera
        try:
            camera = camera_from_message(request.camera_info)
            if own is None or (camera.width, camera.height) != (own.width, own.height):
                size = 'none yet' if own is None else f'{own.width} x {own.height} px'
                raise CameraError(f'image size {camera.width} x {camera.height} px, images have '
                                  f'{size}')
        except CameraError as error:
            response.success, response.status_message = False, str(error)
            return response
        self._replaced = (own, camera)
        self.get_logger().info(f'set_camera_info: focal length {camera.fx:.3f} px, principal '
                               f'point {camera.cx:.2f} {camera.cy:.2f} px')
        response.success = True
        return response

    def sensor_header(self, stamp_ns: int) -> Header:
        """Return a header in the sensor frame."""
        return make_header(stamp_ns, self.options(FrameOptions).sensor_frame_id)


class SourceNode(ImageSourceNode):
    """
    Publishes images at a fixed rate, once enough subscribers are there.

    Until then only camera_info is published, so that every node knows the camera before the
    first image. On a machine that is too slow images are late, which is counted, but none is
    left out: the stamps keep the rate. With frames_ahead an image waits for the nodes, and those
    after it are due later.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._timer: Timer | None = None
        self._begin_ns: int | None = None
        self._inactive_ns: int | None = None
        self._answered_ns: dict[str, int] = {}

    def start_ns(self) -> int:
        """Return the stamp of the first image, in ns since the UNIX epoch."""
        now_ns = self.get_clock().now().nanoseconds
        return self.options(SourceOptions).start_ns() or now_ns

    def start(self, camera: Camera, publish: Callable[[int, int, float], None]) -> None:
        """Call publish(index, stamp_ns, time_s) at the frame rate; time_s counts from image 0."""
        self.stop()
        self._waiting_camera, self._publish = camera, publish
        self._next_index = 0
        self._begin_ns = self._inactive_ns = None
        self._waited_ns, self._published_ns, self._waits = 0, 0, False
        self._follow_answers()
        self._timer = self.create_timer(
            1 / self.options(SourceOptions).frame_rate_hz, self._tick)

    def before_first_image(self, stamp_ns: int) -> None:
        """Get ready for the first image, whose stamp is known now."""

    def stop(self) -> None:
        """Call no more."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def activate(self) -> None:
        # The simulated sky and the order of the files stand still while the node is inactive.
        if self._begin_ns is not None and self._inactive_ns is not None:
            self._begin_ns += self.get_clock().now().nanoseconds - self._inactive_ns

    def deactivate(self) -> None:
        self._inactive_ns = self.get_clock().now().nanoseconds

    def has_users(self, camera: Camera, stamp_ns: int) -> bool:
        """Return whether enough subscribers are there; until then publish the camera for them."""
        options = self.options(SourceOptions)
        # Who waits for users of the camera has one of its images among them.
        images = max(options.wait_for_subscribers, min(options.wait_for_camera_users, 1))
        enough = (self._image.subscriptions >= images
                  and self._camera_info.get_subscription_count() >= options.wait_for_camera_users)
        if not enough:
            self._publish_camera_info(camera, self.sensor_header(stamp_ns))
        return enough

    def _follow_answers(self) -> None:
        """Forget the answers of before; subscribe to them if images wait for them."""
        options = self.options(SourceOptions)
        subscribed = bool(self._answered_ns)
        self._answered_ns = {
            topic: 0 for topic in options.answer_topics if subscribed or options.frames_ahead}
        for topic in () if subscribed else self._answered_ns:
            self.subscribe(Imu, topic, partial(self._on_answer, topic), qos.LIST)

    def _on_answer(self, topic: str, message: Imu) -> None:
        self._answered_ns[topic] = max(
            self._answered_ns[topic], ns_from_stamp(message.header.stamp))

    def _is_ahead(self, begin_ns: int) -> bool:
        """Return whether the next image has to wait for the nodes."""
        options = self.options(SourceOptions)
        index = self._next_index - options.frames_ahead
        return bool(options.frames_ahead) and index >= 0 and (
            min(self._answered_ns.values()) < self._stamp_ns(begin_ns, index))

    def _tick(self) -> None:
        if not self.active:
            return
        options = self.options(SourceOptions)
        now_ns = self.get_clock().now().nanoseconds
        if self._begin_ns is None:
            self._stamp_offset_ns = (options.start_ns() or now_ns) - now_ns
            if not self.has_users(self._waiting_camera, now_ns + self._stamp_offset_ns):
                return
            self._begin_ns = now_ns
            self.before_first_image(now_ns + self._stamp_offset_ns)
        self._publish_due(self._begin_ns, now_ns - self._begin_ns)

    def _publish_due(self, begin_ns: int, elapsed_ns: int) -> None:
        """Publish the next image, elapsed_ns after the first one at begin_ns, if none waits."""
        if self._is_ahead(begin_ns):
            self._waits = True
            if elapsed_ns - self._published_ns < ANSWER_LIMIT_S * 1e9:
                return
            self.diagnostics.counts['images without an answer'] += 1
            self.diagnostics.report(WARN, f'no answer to the last image for {ANSWER_LIMIT_S:g} s: '
                                    'the next one goes out')
        if self._waits:
            # The schedule goes on from here.
            self._waits = False
            self._waited_ns = max(self._waited_ns, elapsed_ns - self._due_ns(self._next_index))
        since_ns = elapsed_ns - self._waited_ns
        self._published_ns = elapsed_ns
        self._publish_next(begin_ns, since_ns)
        # Make up for a missed tick, so that later images are not late, too.
        if since_ns >= self._due_ns(self._next_index) and not self._is_ahead(begin_ns):
            self._publish_next(begin_ns, since_ns)

    def _due_ns(self, index: int) -> int:
        """Return when an image is due, counted from the first one, without waits."""
        return round(index / self.options(SourceOptions).frame_rate_hz * 1e9)

    def _stamp_ns(self, begin_ns: int, index: int) -> int:
        return begin_ns + self._stamp_offset_ns + self._due_ns(index)

    def _publish_next(self, begin_ns: int, since_ns: int) -> None:
        """Publish an image, since_ns after the first one at begin_ns."""
        options = self.options(SourceOptions)
        if options.frame_count and self._next_index >= options.frame_count:
            return
        index, self._next_index = self._next_index, self._next_index + 1
        due_ns = self._due_ns(index)
        self.diagnostics.counts['frames late'] += since_ns - due_ns > 1e9 / options.frame_rate_hz
        self._publish(index, self._stamp_ns(begin_ns, index), due_ns / 1e9)
