# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of each frame of a run by SNA, and by the filters of the star tracker."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_evaluation.campaign.jpdaf_runs import (
    BLOCK_S, CAMERA, Cell, DETECTION_PROBABILITY, DT_S, FRAMES, ORBIT_RATE_RAD_S, Run, STARS)
from startracker_ros.core.attitude.estimate import AttitudeEstimate, estimate_attitude
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.core.papers.neighbourhood import propagated, star_neighbourhood
from startracker_ros.core.track.options import ASSOCIATIONS, TrackerOptions
from startracker_ros.core.track.track_filter import TrackFilter

AS_PUBLISHED = {'solver': 'triad', 'sna_confirmation': True, 'association': 'diffuse',
                'roll_by_gyro': True}
"""The options of the method of the paper, as in config/paper_jpdaf.yaml."""

METHODS = {
    'JPDAF, TRIAD': {'solver': 'triad'}, 'JPDAF, optimal': {},
    'attitude-coupled': {'model': 'attitude'}}
"""Options of filters that do not know the jitter."""

VARIANTS = {
    f'{association}{", confirmed by SNA" if confirmation else ""}': {
        **AS_PUBLISHED, 'association': association, 'sna_confirmation': confirmation}
    for association in ASSOCIATIONS for confirmation in (False, True)}

_LEAST_DEG_S2 = 1e-6


def velocity_changes(cell: Cell) -> tuple[float, float]:
    """
    Return 1-sigma changes per frame, of any star's velocity in px/s and of the roll rate.

    One rule for all cells: the change of velocity that is not in the model, as a random walk of
    the same size. The constant-velocity model lacks the curve of the path across the image, a
    steady acceleration of 2 w^2 times the distance from the centre. Both models lack the roll
    of the jitter, a rate uniform in +-jitter, constant in each block: its change moves stars
    across their radius, and during the block the Coriolis and the centrifugal acceleration of
    a rolling image act. Distances are those of the edge.
    """
    edge_px, focal_px = CAMERA.width / 2, CAMERA.fx
    jitter = np.radians(cell.jitter_deg_s)
    curve = 2 * ORBIT_RATE_RAD_S ** 2 * edge_px
    speed = ORBIT_RATE_RAD_S * (focal_px if cell.motion == 'linear' else edge_px)
    # The rms of a uniform rate is jitter / sqrt(3), that of its square jitter^2 / sqrt(5).
    rolling = np.hypot(2 * jitter / np.sqrt(3) * speed, jitter ** 2 / np.sqrt(5) * edge_px)
    steady = DT_S * np.hypot(curve * np.sqrt(FRAMES), rolling * np.sqrt(BLOCK_S / DT_S))
    return steady, jitter * np.sqrt(2 / 3 * DT_S / BLOCK_S)


def body_changes(cell: Cell) -> tuple[float, float]:
    """
    Return 1-sigma changes per frame of the body rate across and about the boresight, rad/s.

    By the same rule: a rate that is constant in space changes on the axes of a rolling camera.
    """
    across = 0.0
    if cell.motion == 'linear':
        across = (ORBIT_RATE_RAD_S * np.radians(cell.jitter_deg_s) / np.sqrt(3)
                  * np.sqrt(DT_S * BLOCK_S))
    return across, velocity_changes(cell)[1]


def tracker_options(cell: Cell, chosen: dict) -> TrackerOptions:
    """
    Return the options of the star tracker in a cell, with those of a method.

    The process noise is that of the changes by the rule, of the jitter only where it is unknown.
    """
    if chosen.get('roll_by_gyro'):
        cell = replace(cell, jitter_deg_s=0.0)
    if chosen.get('model') == 'attitude':
        across, roll = body_changes(cell)
    else:
        steady, roll = velocity_changes(cell)
        across = steady / CAMERA.fx
    model = {'linear': 'constant_velocity', 'turning': 'coordinated_turn'}[cell.motion]
    accelerations = np.maximum(np.degrees([across, roll]) / DT_S, _LEAST_DEG_S2)
    return TrackerOptions(
        max_stars=STARS, min_stars=STARS - 1, detection_probability=DETECTION_PROBABILITY,
        acceleration_deg_s2=accelerations[0], roll_acceleration_deg_s2=accelerations[1],
        **{'model': model, **chosen})


@dataclass(frozen=True)
class Estimate:
    """
    Attitudes (F, 4) with their covariances (F, 3, 3), and places (F, 4, 2) of the stars in px.

    NaN where a star has none; fixed (F,) is whether a frame has an attitude of its own, not that
    of the frame before turned at its rate.
    """

    quaternion: np.ndarray
    covariance: np.ndarray
    uv: np.ndarray
    fixed: np.ndarray


def track(run: Run, options: TrackerOptions, with_gyro: bool = False) -> Estimate:
    """
    Return the estimate of the star tracker, which knows nothing but what a node receives.

    Frames are identified until it tracks; the first one has the attitude of its identification.
    """
    numbers = np.arange(1, STARS + 1, dtype=np.int32)
    tracker = TrackFilter(CAMERA, OnboardCatalog(
        numbers, run.icrf, np.full(STARS, 4.0), *np.zeros((2, STARS), bool)), options)
    attitudes, covariances, fixed = [], [], []
    places = np.full((FRAMES, STARS, 2), np.nan)
    rate = run.gyro_rad_s[0]
    for k, (uv, seen) in enumerate(zip(run.centroids, run.seen)):
        stamp_ns = round((k + 1) * DT_S * 1e9)
        if with_gyro and k:
            tracker.add_rate(stamp_ns, run.gyro_rad_s[k - 1])
        frame = _centroids(run, uv)
        tracks = tracker.update(stamp_ns, frame)
        if tracks is not None and len(tracks):
            places[k, tracks.hip[tracks.hip > 0] - 1] = tracks.uv[tracks.hip > 0]
        visible = seen >= 0
        if tracker.state != 'TRACKING':
            hip = np.zeros(len(uv), np.int32)
            hip[seen[visible]] = numbers[visible]
            tracker.identified(stamp_ns, frame, hip)
        fixed.append(tracker.attitude is not None)
        if tracker.attitude is not None:
            attitude, rate = tracker.attitude.attitude, tracker.attitude.rate_rad_s
        elif not k:
            attitude = _estimate(run, uv[seen[visible]], run.icrf[visible], 'quest')
        else:
            attitude = replace(attitude, quaternion=multiply(
                attitude.quaternion, quaternion_from_rotation_vector(rate * DT_S)))
        attitudes.append(attitude.quaternion)
        covariances.append(attitude.covariance_sensor)
    return Estimate(np.stack(attitudes), np.stack(covariances), places, np.array(fixed))


def star_neighbourhood_estimate(run: Run) -> Estimate:
    """
    Return the estimate of SNA, which knows the true body rate: the positions that it measured.

    TRIAD of three stars or more: two may be next to each other, and the error of one such
    attitude would dominate a run. A missed star is propagated.
    """
    uv_stars = run.start
    attitude = _estimate(run, uv_stars, run.icrf, 'triad')
    quaternions, places, fixed = [attitude.quaternion], [uv_stars], [True]
    for rate, uv in zip(run.rate_rad_s, run.centroids[1:]):
        uv_stars = propagated(CAMERA, uv_stars, rate, DT_S)
        index = star_neighbourhood(CAMERA, uv_stars, run.icrf, uv,
                                   np.full(len(uv), run.cell.sigma_px))
        found = index >= 0
        uv_stars[found] = uv[index[found]]
        places.append(np.where(found[:, None], uv_stars, np.nan))
        fixed.append(found.sum() >= 3)
        if fixed[-1]:
            attitude = _estimate(run, uv_stars[found], run.icrf[found], 'triad')
            quaternions.append(attitude.quaternion)
        else:
            quaternions.append(multiply(
                quaternions[-1], quaternion_from_rotation_vector(rate * DT_S)))
    return Estimate(np.stack(quaternions), np.empty((0, 3, 3)), np.stack(places),
                    np.array(fixed))


def _centroids(run: Run, uv: np.ndarray) -> Centroids:
    return Centroids(uv=uv, flux=np.ones(len(uv)), snr=np.full(len(uv), 30.0),
                     sigma_px=np.full(len(uv), run.cell.sigma_px))


def _estimate(run: Run, uv: np.ndarray, icrf: np.ndarray, solver: str
              ) -> AttitudeEstimate:
    return estimate_attitude(CAMERA.unproject(uv), icrf, np.full(
        len(uv), run.cell.sigma_px * CAMERA.pixel_rad), solver)
