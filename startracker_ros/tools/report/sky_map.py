# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the boresight went and which stars were used, as plain data for a map."""

from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.deep import load_deep_catalog, NUMBER_OFFSET
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.tools.report.panels import numbers, Panels, thinned, usable

# A wider path is drawn on a map of the whole sky.
_WIDEST_DEG = 60.0
_BACKGROUND_STARS = 500


def sky_map(panels: Panels) -> dict[str, Any] | None:
    """Return path, stars, image border and centre of the map; None without an attitude."""
    recording = panels.recording
    if not len(recording.attitude_ns):
        return None
    boresight = matrix_from_quaternion(recording.quaternion)[:, :, 2]
    keep = thinned([*recording.quaternion.T])
    centre = boresight.mean(axis=0)
    length = float(np.linalg.norm(centre))
    centre = centre / length if length > 1e-6 else boresight[0]
    border = _border(panels)
    half_field = float(np.degrees(np.arccos(min(1.0, border[:, 2].min())))) if len(border) else 1.0
    off_centre = np.arccos(np.clip(boresight @ centre, -1, 1)).max()
    radius_deg = half_field + float(np.degrees(off_centre))
    whole_sky = radius_deg > _WIDEST_DEG
    return {
        't': numbers((recording.attitude_ns[keep] - panels.start_ns) / 1e9, 4),
        'q': [numbers(q, 7) for q in recording.quaternion[keep]],
        'border': [numbers(vector, 6) for vector in border],
        'centre': numbers(centre, 7), 'wholeSky': whole_sky,
        'radiusDeg': 180.0 if whole_sky else round(1.08 * radius_deg, 3),
        'stars': _stars(panels, centre, 180.0 if whole_sky else radius_deg)}


def _border(panels: Panels) -> np.ndarray:
    """Return the unit vectors (N, 3) in the sensor frame once around the image."""
    camera = panels.recording.camera
    if camera is None:
        return np.empty((0, 3))
    side = np.linspace(0, 1, 9)[:-1]
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    around = np.concatenate([a + side[:, None] * (b - a)
                             for a, b in zip(corners, np.roll(corners, -1, axis=0))])
    return camera.unproject(around * (camera.width, camera.height) - 0.5)


def _stars(panels: Panels, centre: np.ndarray, radius_deg: float) -> list[list[float | None]]:
    """Return x, y, z, V, Hipparcos number and frames in use, of those used and bright ones."""
    recording = panels.recording
    if len(recording.tracks):
        used = recording.tracks.rows['hip'][usable(recording.tracks)]
    else:
        used = recording.stars.rows['hip'][recording.stars.rows['hip'] > 0]
    hip, frames = np.unique(used, return_counts=True)
    catalog = load_deep_catalog() if hip.max(initial=0) >= NUMBER_OFFSET else load_catalog()
    in_use = dict(zip(hip.tolist(), frames.tolist()))
    directions = catalog.directions(epoch_year_from_stamp(panels.start_ns))
    inside = np.flatnonzero(directions @ centre > np.cos(np.radians(min(radius_deg * 1.1, 180))))
    # Brightest first, as the catalogue is.
    shown = np.union1d(inside[:_BACKGROUND_STARS], np.flatnonzero(np.isin(catalog.hip, hip)))
    return [[*numbers(directions[star], 6), round(float(catalog.magnitude[star]), 2),
             int(catalog.hip[star]), in_use.get(int(catalog.hip[star]), 0)] for star in shown]
