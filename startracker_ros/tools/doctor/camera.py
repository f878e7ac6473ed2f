# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera file, or a camera that publishes: whether a star tracker can use it."""

from collections.abc import Iterator, Mapping
import json
from pathlib import Path
import subprocess
import sys
import time

import numpy as np
from startracker_ros.core.astro.epoch import (
    catalogue_epoch, epoch_year_from_stamp, why_no_date)
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.ros.processes import node_environment
from startracker_ros.tools.doctor.install import Check

# Narrower fields hold too few stars of the catalogue to be lost in space (docs/catalog.md);
# in wider ones a pixel is too coarse for anything but a try, but fisheyes see dozens of bright
# stars.
_FOV_DEG = (5.0, 60.0)
_AXES_RATIO = 0.02
_CENTRE_SHARE = 0.1
_SATURATED_SHARE = 0.01


def check_camera(camera_file: Path | None, listen_s: float, namespace: str = ''
                 ) -> Iterator[Check]:
    """Yield the checks of a camera file, of a live camera, and whether they agree."""
    of_file = sensor = None
    if camera_file is not None:
        try:
            of_file = load_camera(camera_file)
        except CameraError as error:
            yield Check('camera file', str(error), False,
                        'write it with startracker calibrate or with ROS camera_calibration')
        else:
            yield from check_geometry('camera file', of_file)
    if listen_s:
        done = subprocess.run(
            [sys.executable, '-m', 'startracker_ros.tools.doctor.processes', 'listen',
             str(listen_s), namespace],
            env=node_environment(), capture_output=True, text=True)
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or [f'status {done.returncode}']
            yield Check('camera_info', lines[-1], False, 'fix DDS first: rows above')
            return
        heard = json.loads(done.stdout)
        live, sensor = (_camera(heard['camera_info'], name) for name in ('camera', 'sensor'))
        yield from check_info(heard['camera_info'], live, sensor)
        yield from check_images(heard['image_raw'], heard['camera_info'], live)
    if of_file is not None and sensor is not None and not of_file.is_same(sensor):
        yield Check('camera file and camera_info', 'differ', False,
                    'give the driver this file: the nodes use camera_info only')


def _camera(heard: Mapping, name: str) -> Camera | None:
    values = heard.get(name)
    return values and Camera(**{**values, 'distortion': tuple(values['distortion'])})


def check_geometry(name: str, camera: Camera, sensor: Camera | None = None) -> Iterator[Check]:
    """
    Yield whether focal length and principal point are those of a camera for stars.

    sensor is the camera with the whole sensor, where the images are a part of it.
    """
    fov_deg = np.degrees([camera.seen_x_rad, camera.seen_y_rad])
    holds = _FOV_DEG[0] <= fov_deg.min() and (
        fov_deg.max() <= _FOV_DEG[1] or camera.model.equidistant)
    yield Check(f'{name}: field', f'{camera.width} x {camera.height} px, focal length '
                f'{camera.fx:.1f} px, {fov_deg[0]:.2f} x {fov_deg[1]:.2f} deg', holds,
                '' if holds else 'focal length in px = focal length in mm / pixel size in mm; '
                f'fields from {_FOV_DEG[0]:.0f} to {_FOV_DEG[1]:.0f} deg, and fisheyes '
                '(equidistant), work best')
    if abs(camera.fy / camera.fx - 1) > _AXES_RATIO:
        yield Check(f'{name}: pixels', f'fx {camera.fx:.1f}, fy {camera.fy:.1f} px', False,
                    'star cameras have square pixels: calibrate again')
    whole = sensor or camera
    shift = np.abs([(whole.cx + 0.5) / whole.width - 0.5,
                    (whole.cy + 0.5) / whole.height - 0.5])
    if shift.max() > _CENTRE_SHARE:
        yield Check(f'{name}: principal point', f'({whole.cx:.1f}, {whole.cy:.1f}) px', False,
                    'far from the middle: a crop or a binning that the calibration does not know')


def check_info(heard: Mapping, camera: Camera | None, sensor: Camera | None = None
               ) -> Iterator[Check]:
    """Yield what is wrong with camera_info, or its geometry."""
    if not heard['count']:
        yield Check('camera_info', f'nothing heard of {heard["publishers"]} publishers', False,
                    'start the driver with a camera_info_url; topic names are relative to the '
                    'namespace')
        return
    if camera is None:
        yield Check('camera_info', heard['error'], False, 'calibrate: startracker calibrate')
        return
    yield from check_geometry('camera_info', camera, sensor)
    if heard['best_effort']:
        yield Check('camera_info: reliability', 'best effort, the nodes ask for reliable', False,
                    '-p qos_overrides./camera_info.subscription.reliability:=best_effort')


def check_images(heard: Mapping, info: Mapping, camera: Camera | None) -> Iterator[Check]:
    """Yield whether the images are ones that centroid_extractor can use."""
    if not heard['count']:
        yield Check('image_raw', f'nothing heard of {heard["publishers"]} publishers', False,
                    'start the driver; topic names are relative to the namespace')
        return
    good = not heard['error']
    yield Check('image_raw: encoding', heard['error'] or heard['encoding'], good,
                '' if good else 'let the driver send mono16 or mono8, or a Bayer mosaic as it is')
    if camera is not None:
        size = heard['width'], heard['height']
        agrees = size == (camera.width, camera.height)
        yield Check('image_raw: size', f'{size[0]} x {size[1]} px', agrees,
                    '' if agrees else f'camera_info says {camera.width} x {camera.height}: '
                    'let the driver set its binning and roi, or calibrate at the size in use')
        if heard['frame_id'] != info['frame_id']:
            yield Check('image_raw: frame_id', f'{heard["frame_id"]!r}, camera_info '
                        f'{info["frame_id"]!r}', False, 'give both the same frame_id')
    yield from _check_stamps(heard['stamps_ns'])
    if heard['best_effort']:
        yield Check('image_raw: reliability', 'best effort, the nodes ask for reliable', False,
                    '-p qos_overrides./image_raw.subscription.reliability:=best_effort')
    if good:
        dark = heard['max_dn'] == heard['median_dn']
        bright = not dark and heard['brightest_share'] > _SATURATED_SHARE
        yield Check('image_raw: light', f'median {heard["median_dn"]:.0f} DN, brightest '
                    f'{heard["max_dn"]} DN', not dark and not bright,
                    'every pixel is alike: lens cap, or exposure zero' if dark else
                    'more than 1 % of the pixels saturated: shorter exposure, less gain'
                    if bright else '')


def _check_stamps(stamps_ns: list[int]) -> Iterator[Check]:
    steps_ns = np.diff(stamps_ns)
    if len(steps_ns):
        holds = bool((steps_ns > 0).all())
        span_s = (stamps_ns[-1] - stamps_ns[0]) * 1e-9
        yield Check('image_raw: rate', f'{len(steps_ns) / span_s:.2f} Hz, longest gap '
                    f'{steps_ns.max() * 1e-6:.0f} ms' if holds else 'stamps do not increase',
                    holds, '' if holds else 'the driver must stamp each exposure; frames out of '
                    'order are dropped')
    stamp_ns, now_ns = stamps_ns[-1], time.time_ns()
    no_date = why_no_date(stamp_ns, catalogue_epoch(stamp_ns, now_ns).other_clock)
    yield Check('image_raw: stamp', f'J{epoch_year_from_stamp(stamp_ns):.2f}, '
                f'{(now_ns - stamp_ns) * 1e-9:.1f} s ago', not no_date, no_date)
