# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Re-acquisition of a head by a hint: from the centroids of its first frame to an attitude."""

import time

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.maths.compiled_rotation import turned
from startracker_ros.core.maths.rotation import random_attitude
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.track.track_filter import TrackFilter
from startracker_ros.core.track.tracks import Hint
from startracker_ros.tools.figures.correctness import verdict
from startracker_ros.tools.figures.rows import Row

_CAMERA, _EPOCH_YEAR = Camera.from_fov(1024, 1024, 12.0), 2026.5
_HINT_RAD = np.radians(1.0)
_RATE = np.radians([0.2, -0.1, 0.3])
_MOST_STARS, _FAINTEST, _SIGMA_PX = 40, 6.5, 0.1
_HINT_AGE_S, _STEP_S = 0.2, 0.2
_STARTS, _LAST = 40, 5  # in a run; frames after which a start has failed


def hint_runs(runs: int, seed: int) -> np.ndarray:
    """
    Return frames to an attitude, whether it is wrong and gross, processor time in ms of starts.

    The time is that of the first frame: tracker, identification lost in space, start.
    """
    rng, epoch_ns = np.random.default_rng(seed), stamp_from_epoch_year(_EPOCH_YEAR)
    sky = onboard_catalog(load_catalog(), _CAMERA, _EPOCH_YEAR, _FAINTEST)
    stage = IdentificationStage(_CAMERA, _EPOCH_YEAR)
    TrackFilter(_CAMERA, sky).warm_up()
    rows = []
    for start in range(_STARTS * runs):
        q, tracker = random_attitude(rng), TrackFilter(_CAMERA, sky)
        first_ns = epoch_ns + start * 10 ** 9
        hinted = turned(turned(q, -_RATE * _HINT_AGE_S), _HINT_RAD * rng.standard_normal(3))
        tracker.add_hint(Hint(first_ns - round(_HINT_AGE_S * 1e9), hinted,
                              np.eye(3) * _HINT_RAD ** 2, _RATE, np.eye(3) * 1e-10))
        spent_s = []
        for frame in range(_LAST):
            stamp_ns, truth = first_ns + round(frame * _STEP_S * 1e9), turned(
                q, _RATE * frame * _STEP_S)
            centroids, _ = star_list(sky, _CAMERA, truth, _SIGMA_PX, rng)
            centroids = centroids.select(np.argsort(-centroids.flux)[:_MOST_STARS])
            begin_s = time.process_time()
            tracker.update(stamp_ns, centroids)
            identified, used = stage.identify(stamp_ns, centroids)
            tracker.identified(stamp_ns, used, identified.hip)
            spent_s.append(time.process_time() - begin_s)
            if tracker.attitude is not None:
                break
        rows.append([*_result(tracker, truth, len(spent_s)), spent_s[0] * 1e3])
    return np.array(rows)


def _result(tracker: TrackFilter, truth: np.ndarray, frames: int) -> tuple[float, float, float]:
    """Return frames to an attitude, infinite without one, and whether it is wrong and gross."""
    tracked = tracker.attitude
    if tracked is None:
        return np.inf, 0.0, 0.0
    estimate = tracked.attitude
    return frames, *verdict(estimate.quaternion, estimate.covariance_sensor, truth)


def hint_rows(case: str, rows: np.ndarray) -> list[Row]:
    """Return the rows of starts (N, 4)."""
    frames, (wrong, gross) = float(rows[:, 0].max()), rows[:, 1:3].sum(axis=0)
    spent_ms = float(np.median(rows[:, 3]))
    return [Row('re-acquisition by a hint of 1 deg: starts', len(rows), ''),
            Row('re-acquisition by a hint of 1 deg: frames, at most', frames, 'frames', most=1),
            *(Row(f're-acquisition by a hint of 1 deg: {kind} attitudes', count, '',
                  exactly=0) for kind, count in (('wrong', wrong), ('gross', gross))),
            Row('re-acquisition by a hint of 1 deg: processor time', spent_ms, 'ms', most=0.5)]
