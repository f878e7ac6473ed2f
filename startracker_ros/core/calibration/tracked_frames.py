# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames for a lens filter out of tracks and the centroids to which they belong."""

import math

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions, ObserverState
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.lens_filter import check_stars, LensFrame
from startracker_ros.core.calibration.matching import nearest_pairs
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.track.tracks import Tracks

# The pixel of a track is that of the attitude; its centroid is an error of lens and image away.
_GATE_PX = 3.0
_NORTH = np.array([0.0, 0.0, 0.0, 1.0])


def tracked_frame(camera: Camera, onboard: OnboardCatalog, stamp_ns: int, centroids: Centroids,
                  tracks: Tracks, observer_state: ObserverState | None = None,
                  temperature_c: float = math.nan) -> LensFrame:
    """
    Return the identified stars of one frame, as measured.

    Tracks are filtered with the camera in use, so their pixels would hide its errors: the
    centroids are used, each with the catalogue star of its track, at the time of the stamp.
    Blended stars are left out. CalibrationError for a frame that is not one of this camera.
    """
    shown = np.isfinite(tracks.uv).all(axis=1) & (tracks.hip > 0) & (tracks.missed == 0)
    seen = np.flatnonzero(shown)
    usable = np.flatnonzero(np.isfinite(centroids.uv).all(axis=1) & (centroids.sigma_px > 0))
    pair, star = nearest_pairs(centroids.uv[usable], tracks.uv[seen], _GATE_PX)
    pair, star = usable[pair], seen[star]
    index = onboard.index_of(tracks.hip[star])
    known = (index >= 0) & ~onboard.crowded[index]
    pair, star, index = pair[known], star[known], index[known]
    direction = onboard.direction[index]
    if observer_state is not None:
        direction = apparent_directions(direction, observer_state)
    # Rows of a rolling shutter have times of their own.
    uv = centroids.uv[pair] - tracks.velocity[star] * centroids.delay_s[pair, None]
    frame = LensFrame(stamp_ns, uv, centroids.sigma_px[pair], direction, _NORTH, temperature_c)
    check_stars(frame, camera)
    try:
        attitude = estimate_attitude(
            camera.unproject(uv), direction, frame.sigma_px * camera.pixel_rad)
    except AttitudeError as error:
        raise CalibrationError(f'no attitude: {error}') from error
    return LensFrame(stamp_ns, uv, frame.sigma_px, direction, attitude.quaternion, temperature_c)
