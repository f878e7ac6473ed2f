# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The data sheet of a night: images in, rows out."""

from pathlib import Path

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.table import Result
from startracker_ros.tools.night.earth_motion import fit_motion
from startracker_ros.tools.night.frames import observe
from startracker_ros.tools.night.rows import all_rows, MISSED, Night
from startracker_ros.tools.night.sources import camera_of_bag, NightError, timed_images

_LEAST_ATTITUDES = 3


def night(source: Path, camera: Camera | None, *, site: Site | None = None,
          start_year: float | None = None, interval_s: float | None = None,
          tracking: bool = False, namespace: str | None = None) -> Result:
    """
    Return the data sheet of the camera that took the images of a bag, a folder or a video.

    camera None is that of the bag. The camera stands still on the Earth or, tracking, turns there
    at a constant rate about a constant axis. NightError for images that are no night of it;
    ImageError, BagError.
    """
    camera = camera or camera_of_bag(source, namespace)
    frames = observe(timed_images(source, start_year, interval_s, namespace), camera, site)
    with_attitude = [frame for frame in frames if frame.alone is not None]
    if len(with_attitude) < _LEAST_ATTITUDES:
        raise NightError(f'{source}: {len(with_attitude)} of {len(frames)} images are identified')
    stamps = np.array([frame.stamp_ns for frame in frames])
    motion = fit_motion(np.array([frame.stamp_ns for frame in with_attitude]),
                        np.array([frame.alone for frame in with_attitude]), tracking)
    rows = all_rows(Night(camera, frames, motion, tracking, site is not None))
    return Result('night', rows, {
        'begin': utc(stamps[0]), 'end': utc(stamps[-1]), 'frames': len(frames),
        'interval_s': float(np.median(np.diff(stamps))) * 1e-9,
        'camera': f'{camera.width} x {camera.height} px, {np.degrees(camera.fov_x_rad):.2f} deg',
        'mount': 'constant rate' if tracking else 'fixed to the Earth',
        'site': 'none: no refraction, no diurnal aberration' if site is None else
        f'{site.latitude_deg:g} {site.longitude_deg:g} {site.height_m:g}',
        'goals missed': '; '.join(each.case for each in rows if each.verdict == MISSED) or 'none',
    })
