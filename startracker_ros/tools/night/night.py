# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The data sheet of a night: images in, rows out."""

from collections.abc import Iterable
from dataclasses import replace
import json
from pathlib import Path
import sys

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.table import Result
from startracker_ros.tools.night.earth_motion import fit_motion
from startracker_ros.tools.night.frames import observe
from startracker_ros.tools.night.intervals import CONFIDENCE
from startracker_ros.tools.night.rows import all_rows, MET, MISSED, Night
from startracker_ros.tools.night.sources import camera_of_bag, NightError, timed_images, TimedImage

_LEAST_FRAMES = 20
_WRONG_RAD = np.radians(1.0)
"""No mount shakes so much: an attitude that is off by more is that of another field."""
_TURNING_RAD_S = 5 * ARCSEC
"""No tripod gives way so fast, a third of the rate of the sky."""


def night(source: Path, camera: Camera | None, *, site: Site | None = None,
          start_year: float | None = None, interval_s: float | None = None,
          tracking: bool = False, namespace: str | None = None,
          datasheet: Path | None = None) -> Result:
    """
    Return the data sheet of the camera that took the images of a bag, a folder or a video.

    camera None is that of the bag. The camera stands still on the Earth or, tracking, turns there
    at a constant rate about a constant axis. datasheet is JSON of `startracker datasheet`.
    NightError for images that are no night of it, and for a file that is no such document;
    ImageError, BagError.
    """
    simulated = {} if datasheet is None else _figures_at_rest(datasheet)
    camera = camera or camera_of_bag(source, namespace)
    left_out = list[str]()
    images = timed_images(source, start_year, interval_s, namespace, zone_needed=site is not None,
                          left_out=left_out)
    seen = measure(_progress(images), camera, site, tracking)
    rows = [replace(each, simulated=simulated.get(each.case)) for each in all_rows(seen)]
    stamps = np.array([frame.stamp_ns for frame in seen.frames])
    goals = [each for each in rows if each.verdict in (MET, MISSED)]
    return Result('night', rows, {
        'begin': utc(stamps[0]), 'end': utc(stamps[-1]), 'frames': len(stamps),
        **({'left_out': '; '.join(left_out)} if left_out else {}),
        'interval_s': float(np.median(np.diff(stamps))) * 1e-9,
        'camera': f'{camera.width} x {camera.height} px, {np.degrees(camera.fov_x_rad):.2f} deg',
        'mount': 'constant rate' if tracking else 'fixed to the Earth',
        'site': 'none: no refraction, no diurnal aberration' if site is None else
        f'{site.latitude_deg:g} {site.longitude_deg:g} {site.height_m:g}',
        'goals': len(goals),
        'missed': '; '.join(each.case for each in goals if each.verdict == MISSED) or 'none',
        'missed_by_chance': (1 - CONFIDENCE) * len(goals),
    }, notes={'missed_by_chance': 'expected, of an ideal instrument'})


def _progress(images: Iterable[TimedImage]) -> Iterable[TimedImage]:
    """Return the images, counted on a terminal."""
    if not sys.stderr.isatty():
        return images
    from rich.console import Console
    from rich.progress import track
    return track(images, 'night', total=None, console=Console(stderr=True), transient=True)


def _figures_at_rest(datasheet: Path) -> dict[str, float | None]:
    """Return the figures of a data sheet at rest, by the cases of a night."""
    try:
        rows = json.loads(datasheet.read_bytes())['rows']
        return {each['case'].replace(', 0 deg/s', ''): each['ours'] for each in rows}
    except (ValueError, KeyError, TypeError) as error:
        raise NightError(f'{datasheet}: not a document of startracker datasheet --json') from error


def measure(images: Iterable[TimedImage], camera: Camera, site: Site | None, tracking: bool
            ) -> Night:
    """Return what the images of a camera show, with the motion that fits them; NightError."""
    frames = observe(images, camera, site)
    known = [index for index, frame in enumerate(frames) if frame.alone is not None]
    if len(known) < _LEAST_FRAMES:
        raise NightError(f'{len(known)} of {len(frames)} images are identified, at least '
                         f'{_LEAST_FRAMES} are needed')
    stamps = np.array([frames[index].stamp_ns for index in known])
    quaternions = np.array([frames[index].alone for index in known])
    motion = fit_motion(stamps, quaternions, tracking)
    off_rad = np.linalg.norm(attitude_error(quaternions, motion.icrf(stamps)), axis=1)
    for index in np.array(known)[off_rad > _WRONG_RAD]:
        frames[index] = frames[index]._replace(alone=None)
    found = int(np.sum(off_rad <= _WRONG_RAD))
    if found < _LEAST_FRAMES:
        does = 'turns at a constant rate' if tracking else 'stands still on the Earth'
        raise NightError(f'{found} of {len(known)} attitudes are those of a camera that {does}, '
                         f'at least {_LEAST_FRAMES} are needed')
    rate_rad_s = float(np.linalg.norm(motion.rate_rad_s))
    if rate_rad_s > _TURNING_RAD_S and not tracking:
        raise NightError(f'the camera turns by {rate_rad_s / ARCSEC:.3g} arcsec/s on the Earth: '
                         '--tracking, if that is the rate of its mount')
    return Night(camera, frames, motion, tracking, site is not None)
