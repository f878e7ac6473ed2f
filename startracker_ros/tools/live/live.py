# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera with the star tracker behind it: state, attitude and annotated sky while it runs."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime
from functools import partial
from pathlib import Path
import shutil
import signal
from threading import Event
import time
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
import cv2
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from sensor_msgs.msg import Image, Imu, PointCloud2
from startracker_ros.core.astro.bodies import bodies_at
from startracker_ros.core.astro.epoch import catalogue_epoch
from startracker_ros.core.attitude.result import pointing_sigma
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.constellations import constellation_at
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.ctrl_c import noted_ctrl_c
from startracker_ros.core.exposure.control import Setting
from startracker_ros.core.exposure.image_figures import FWHM_PER_SIGMA
from startracker_ros.core.folders import replaced
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.integrity.checks import START_RATE
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, pointing_from_quaternion, rotate)
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.io.bags.layouts import image_from_message, MessageError, ns_from_stamp
from startracker_ros.io.images.camera_files import load_camera, save_camera
from startracker_ros.io.images.capture import (
    Captured, CaptureError, CaptureOptions, Device, open_device)
from startracker_ros.io.images.images import ImageError
from startracker_ros.io.table import Result
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.picture import annotated
from startracker_ros.photographs.solution import Solution
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import attitude_from_pose
from startracker_ros.ros.messages.clouds import centroids_from_message, tracks_from_message
from startracker_ros.ros.messages.serialized import deserialized
from startracker_ros.ros.processes import HarnessError
from startracker_ros.ros.rig import Rig
from startracker_ros.tools.live.sky_page import (
    exposure_text, focus_text, PICTURE, SkyPage, state_texts, THIS_MACHINE)

_SHOW_S, _DRAW_S = 0.25, 1.0
_CTRL_C_S = 0.5
_IMAGES, _KEPT_NS = 5, 5_000_000_000
_JPEG_QUALITY = 90
_LEAST_RESIDUAL_PX, _RESIDUAL_SIGMAS = 1.0, 3.0
_SOURCE, _EXTRACTOR = 'camera_source: camera', 'centroid_extractor: centroids'
_END = 'all images of '
_NO_FRAMES = 'nothing received yet'
_JUMP = START_RATE.diagnostic.partition('{')[0]
_SOLVE = 'solve unrelated photographs with startracker solve'
_MOST_DEG_S = TrackerOptions().max_rate_deg_s

# The false-alarm probability holds for one image; here many are tried.
_LEAST_MATCHED = 8
_OPTIONS = IdentificationOptions(fov_error_percent=5.0)


class LiveView:
    """What a terminal and the page show; the picture is a file in the output folder as well."""

    def __init__(self, page: SkyPage, live: Live, picture: Path) -> None:
        self._page, self._live, self._picture = page, live, picture
        self._shown_s = self._drawn_s = 0.0

    def show(self, texts: Callable[[], dict[str, str]]) -> None:
        """Show the texts by name, four times a second."""
        if time.monotonic() - self._shown_s < _SHOW_S:
            return
        self._shown_s = time.monotonic()
        self._page.state = state = texts()
        table = Table(title=f'startracker live, {self._page.url}', title_justify='left',
                      show_header=False, min_width=70)
        for name, value in state.items():
            table.add_row(name, value.replace('\n', ', '))
        self._live.update(table)

    def draw(self, draw: Callable[[float], np.ndarray | None]) -> None:
        """
        Show once a second the picture that the function returns, (H, W, 3) RGB.

        It has marks for a screen that is so many times 1024 px wide.
        """
        if time.monotonic() - self._drawn_s < _DRAW_S:
            return
        for name, share in self._page.wanted().items():
            picture = draw(share)
            if picture is None:
                return
            self._drawn_s = time.monotonic()
            good, content = cv2.imencode('.jpg', picture[..., ::-1],
                                         [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            if good:
                self._page.pictures[name] = content.tobytes()
        # Complete at any time, for a viewer that reads it again and again.
        with replaced(self._picture) as file:
            file.write(self._page.pictures[PICTURE])


class LiveRig(Rig):
    """Camera and star tracker as processes in the ROS domain of the user, and their messages."""

    def __init__(self, logs: Path, camera: Camera) -> None:
        super().__init__(logs, isolated=False, name='live_monitor')
        self._camera = camera
        self.state, self.reason = 'starting', ''
        self.counts = {'frames': 0, 'frames_tracking': 0}
        self._jump, self._jumps, self._received_s = '', 0, float('nan')
        self.attitude: np.ndarray | None = None
        self.covariance = np.full((3, 3), np.nan)
        self.rate_deg_s = float('nan')
        # The lists of an image arrive some time after it.
        self._images: deque[Image] = deque(maxlen=_IMAGES)
        self._stamped: dict[str, dict[int, Any]] = {
            topic: {} for topic in ('attitude', 'tracks', 'centroids')}
        self._statuses: dict[str, DiagnosticStatus] = {}
        subscribe = self.probe.create_subscription
        subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.LIST)
        subscribe(Image, 'image_raw', self._on_image, qos.IMAGE, raw=True)
        subscribe(DiagnosticStatus, 'tracker_state', self._on_tracker_state, qos.STATE)
        subscribe(PoseWithCovarianceStamped, 'attitude_cov', self._on_attitude, qos.LIST)
        subscribe(Imu, 'attitude_imu', self._on_attitude_imu, qos.LIST)
        for topic in ('tracks', 'centroids'):
            subscribe(PointCloud2, topic, partial(self._on_list, topic), qos.LIST)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._statuses.update({status.name: status for status in message.status})

    def _on_image(self, data: bytes) -> None:
        self._images.append(deserialized(data, Image))
        self._received_s = time.monotonic()
        self.counts['frames'] += 1

    def _on_tracker_state(self, message: DiagnosticStatus) -> None:
        self.state = message.message
        self.reason = {value.key: value.value for value in message.values}.get('reason', '')
        self.counts['frames_tracking'] += self.state == 'TRACKING'
        if self.reason.startswith(_JUMP):
            self._jump, self._jumps = self.reason, self._jumps + 1
        if self.state != 'TRACKING':
            self.attitude, self.rate_deg_s = None, float('nan')

    def _on_attitude(self, message: PoseWithCovarianceStamped) -> None:
        try:
            self.attitude, self.covariance = attitude_from_pose(message, message.header.frame_id)
        except MessageError as error:
            # From another node: the estimator publishes none that is not an attitude.
            self.probe.get_logger().warning(f'attitude_cov: {error}', throttle_duration_sec=10.0)
            return
        self._keep('attitude', message.header.stamp, self.attitude)

    def _on_attitude_imu(self, message: Imu) -> None:
        rate = message.angular_velocity
        known = message.angular_velocity_covariance[0] >= 0
        self.rate_deg_s = float(np.degrees(np.linalg.norm([rate.x, rate.y, rate.z]))
                                ) if known else float('nan')

    def _on_list(self, topic: str, message: PointCloud2) -> None:
        self._keep(topic, message.header.stamp, message)

    def _keep(self, topic: str, stamp: Time, value: Any) -> None:
        kept, stamp_ns = self._stamped[topic], ns_from_stamp(stamp)
        kept[stamp_ns] = value
        for old_ns in [old for old in kept if old < stamp_ns - _KEPT_NS]:
            del kept[old_ns]

    @property
    def source_text(self) -> str:
        """Return the condition of the camera."""
        status = self._statuses.get(_SOURCE)
        # A status is up to a second older than the newest frame.
        if status is None or self.counts['frames'] and status.message == _NO_FRAMES:
            return ''
        return status.message

    @property
    def problem(self) -> str:
        """Return that the images are not one sequence, each identified elsewhere; or ''."""
        if self._jumps <= self.counts['frames_tracking']:
            return ''
        return f'the images are not one sequence: {self._jump}; {_SOLVE}'

    def _diagnostic(self, name: str, key: str) -> float:
        """Return the newest number of a key in the status of a name, NaN without one."""
        status = self._statuses.get(name, DiagnosticStatus())
        return float({value.key: value.value for value in status.values}.get(key, 'nan'))

    def figures(self) -> dict[str, Any]:
        """Return state, pointing with its 1 sigma, rate, stars and camera; NaN if not known."""
        angles, sigma, constellation = np.full(3, np.nan), np.full(3, np.nan), ''
        if self.attitude is not None:
            angles = np.degrees(pointing_from_quaternion(self.attitude))
            sigma = pointing_sigma(self.attitude, self.covariance) / ARCSEC
            constellation = constellation_at(rotate(self.attitude, [0.0, 0.0, 1.0]))
        tracks = self._stamped['tracks']
        hip = tracks_from_message(tracks[max(tracks)]).hip if tracks else np.empty(0)
        names = 'ra', 'dec', 'roll'
        return {'state': self.state,
                **{f'{name}_deg': float(angle) for name, angle in zip(names, angles)},
                **{f'{name}_sigma_arcsec': float(error) for name, error in zip(names, sigma)},
                'constellation': constellation, 'rate_deg_s': self.rate_deg_s,
                'stars': int(np.count_nonzero(hip)),
                'fwhm_px': self._diagnostic(_EXTRACTOR, 'fwhm_px'),
                'exposure_ms': self._diagnostic(_SOURCE, 'exposure_ms'),
                'gain': self._diagnostic(_SOURCE, 'gain'), **self.counts}

    def texts(self) -> dict[str, str]:
        """Return what is shown."""
        return state_texts(self.figures(), self.problem or self.reason, self.source_text,
                           time.monotonic() - self._received_s)

    def picture(self, share: float) -> np.ndarray | None:
        """
        Return the newest image with an attitude, or with spots, or any; None without one.

        Its marks are for a screen that is so many times 1024 px wide.
        """
        by_stamp = {ns_from_stamp(image.header.stamp): image for image in self._images}
        if not by_stamp:
            return None
        attitudes, tracks, spots = (self._stamped[topic]
                                    for topic in ('attitude', 'tracks', 'centroids'))
        stamp_ns, sky = max(by_stamp), None
        uv, hip = np.empty((0, 2)), np.empty(0, int)
        if known := by_stamp.keys() & attitudes.keys() & tracks.keys():
            stamp_ns = max(known)
            sky = SkyMapping(self._camera, attitudes[stamp_ns])
            uv, hip = (stars := tracks_from_message(tracks[stamp_ns])).uv, stars.hip
        elif seen := by_stamp.keys() & spots.keys():
            stamp_ns = max(seen)
            uv = centroids_from_message(spots[stamp_ns]).uv
            hip = np.zeros(len(uv), int)
        bodies = () if sky is None else Bodies(bodies_at(stamp_ns)).in_image(sky)
        return annotated(image_from_message(by_stamp[stamp_ns]).in_full(), uv, hip, sky,
                         catalogue_epoch(stamp_ns).year, bodies, share)


def run_live(output: Path, capture: CaptureOptions, *, camera_file: Path | None = None,
             fov_deg: float | None = None, record: bool = False,
             host: str = THIS_MACHINE, port: int = 0, seconds: float = float('inf')) -> Result:
    """
    Run camera and star tracker until SIGINT or SIGTERM, the end of the files, or for seconds.

    Without a camera_file the lens is that of the first image that is solved; fov_deg is its
    field of view to 5 %, None where it is unknown. HarnessError when a node fails, CameraError
    for an invalid camera file.
    """
    logs = output / 'logs'
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir(parents=True)
    picture, bag = output / 'sky.jpg', output / f'bag_{datetime.now():%Y%m%d_%H%M%S}'
    begin_s = time.monotonic()
    with SkyPage(host, port) as page, Live(console=Console(stderr=True), transient=True) as live:
        view = LiveView(page, live, picture)
        error_px = 0.0
        if camera_file is None:
            camera_file = output / 'camera.yaml'
            error_px = _estimate_lens(view, capture, fov_deg, camera_file)
        camera = load_camera(camera_file)
        # Not by an exception: it would come in the midst of anything.
        with noted_ctrl_c() as stopped, LiveRig(logs, camera) as rig:
            if record:
                rig.processes.start('bag_recorder', {'folder': str(bag)})
            rig.processes.start('composed_pipeline', _pipeline_parameters(error_px))
            with suppress(KeyboardInterrupt):
                _watch(rig, view, begin_s + seconds, {
                    **asdict(capture), 'camera_file': str(camera_file)}, stopped)
            codes = rig.stop()
            # One that was ended while it was still imported has no handler yet.
            if bad := [f'{name} (status {code})' for name, code in codes.items()
                       if code not in (0, -signal.SIGTERM, -signal.SIGINT)]:
                raise HarnessError(f'{", ".join(bad)} did not end cleanly: see {logs}')
            return Result('live', [rig.figures()], {
                'device': capture.device, 'camera_file': str(camera_file),
                'field': f'{np.degrees(camera.seen_x_rad):.2f} deg', 'picture': str(picture),
                **({'bag': str(bag)} if record else {}),
                **({'problem': rig.problem} if rig.problem else {})})


def _pipeline_parameters(error_px: float) -> dict[str, object]:
    """Return parameters for a lens that leaves errors of error_px, the defaults below 0.2 px."""
    if error_px < 0.2:
        return {}
    return {'sigma_floor_px': min(error_px, 10.0),
            'max_residual_px': max(_LEAST_RESIDUAL_PX, _RESIDUAL_SIGMAS * error_px)}


def _estimate_lens(view: LiveView, capture: CaptureOptions, fov_deg: float | None,
                camera_file: Path) -> float:
    """Write the lens of the first image that is solved, and return its error in px."""
    view.show(lambda: {'state': 'opening the camera'})

    def on_image(captured: Captured, uv: np.ndarray, reason: str) -> None:
        psf_sigma_px = CentroidExtractor().measure(captured.image, points_only=True).psf_sigma_px
        setting = captured.setting or Setting(float('nan'), -1.0)
        view.show(lambda: {'state': f'learning the lens\n{reason}'.rstrip(),
                           'focus': focus_text(FWHM_PER_SIGMA * psf_sigma_px),
                           'exposure': exposure_text(*setting), 'camera': capture.device})
        view.draw(lambda share: annotated(
            captured.image, uv, np.zeros(len(uv), int), None, 2000.0, share=share))
    try:
        device = open_device(capture, lambda wait_s: None)
        try:
            lens = first_lens(device, fov_deg, on_image)
        finally:
            device.close()
    except (CaptureError, ImageError) as error:
        raise HarnessError(str(error)) from error
    if lens is None:
        raise HarnessError(f'{capture.device}: no image is solved: give --camera, or --fov-deg')
    save_camera(lens.camera, camera_file)
    return lens.error_px


def _watch(rig: LiveRig, view: LiveView, end_s: float, source: dict[str, object],
           stopped: Event) -> None:
    """Show until stopped, or until time or files end; HarnessError when a process does."""
    started = False
    while time.monotonic() < end_s and not stopped.is_set():
        rig.probe.spin_once(0.1)
        # Every stage subscribes to camera_info once it has loaded its code.
        if not started and rig.probe.count_subscribers('camera_info') >= len(STAGES):
            rig.processes.start('camera_source', source)
            started = True
        view.show(rig.texts if started else lambda: {'state': 'loading'})
        view.draw(rig.picture)
        # Ctrl-C of a terminal reaches all processes, and may end another one first.
        if (ended := rig.processes.ended()) and not stopped.wait(_CTRL_C_S):
            raise HarnessError(f'{", ".join(ended)} ended early: see {rig.log_folder}')
        if rig.source_text.startswith(_END):
            # Frames in flight.
            rig.probe.spin_for(1.0)
            return


class FirstLens(NamedTuple):
    """A camera, and the 1-sigma error per axis in px that its lens leaves in a star's pixel."""

    camera: Camera
    error_px: float


def first_lens(device: Device, fov_deg: float | None,
               on_image: Callable[[Captured, np.ndarray, str], None]) -> FirstLens | None:
    """
    Return the lens of the first image of a device that is solved, None when its images end.

    fov_deg is the horizontal field of view to 5 %, None where it is unknown. on_image receives
    each image, its spots (N, 2) and why it is not solved, empty if it is. HarnessError where the
    next file shows another field than a star tracker can follow to.
    """
    solver = None
    while (captured := device.read()) is not None:
        image = captured.image
        if solver is None:
            height, width = image.shape
            camera = None if fov_deg is None else Camera.from_fov(width, height, fov_deg)
            solver = PhotographSolver(catalogue_epoch(captured.stamp_ns).year, _OPTIONS)
        solution = solver.solve(image, camera)
        found = solution.identification
        solved = solution.sky is not None and found.matched >= _LEAST_MATCHED
        few = f'{found.matched} stars, {_LEAST_MATCHED} are needed for a lens'
        on_image(captured, solution.centroids.uv,
                 '' if solved else found.reason if solution.sky is None else few)
        if not solved:
            continue
        if device.ends and (later := device.read()) is not None:
            _check_sequence(device.name, solution, solver.solve(later.image, solution.camera),
                            (later.stamp_ns - captured.stamp_ns) * 1e-9)
        return FirstLens(solution.camera, solution.lens_px)
    return None


def _check_sequence(name: str, first: Solution, second: Solution, step_s: float) -> None:
    """Raise HarnessError where one image and the next have fields too far apart to be tracked."""
    if first.quaternion is None or second.quaternion is None:
        return
    turn_deg = np.degrees(np.linalg.norm(attitude_error(second.quaternion, first.quaternion)))
    if turn_deg > _MOST_DEG_S * step_s:
        raise HarnessError(f'{name}: the images are not one sequence: two in a row are '
                           f'{turn_deg:.3g} deg apart in {step_s:.2g} s; {_SOLVE}')
