# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moving objects linked among false centroids; not stars, hot pixels and hits."""

import numpy as np
from skies import CAMERA
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.tracklets import Detections, link_tracklets

BEGIN = quaternion_from_rotation_vector([0.4, 1.1, -0.7])
SIGMA_PX = 0.14


def attitude(t):
    return multiply(BEGIN, quaternion_from_rotation_vector([0.0, 0.001 * t, 0.0]))


def scene(objects=(), hot=(), stars=(), false=0.5, frames=200, missing=0.05, seed=1):
    """Return detections; objects are (frame, uv of BEGIN, rate (3,) rad/s)."""
    rng = np.random.default_rng(seed)
    rows = []
    for frame in range(frames):
        q = attitude(frame)
        seen = [CAMERA.project(rotate(conjugate(q), rotate(
            quaternion_from_rotation_vector(np.array(rate) * (frame - begin)),
            rotate(attitude(begin), CAMERA.unproject(np.array(uv))))))
            for begin, uv, rate in objects if abs(frame - begin) < 40]
        seen += [CAMERA.project(rotate(conjugate(q), star)) for star in stars]
        seen += [np.array(uv) for uv in hot]
        noisy = [uv + rng.normal(0, SIGMA_PX, 2) for uv in seen
                 if rng.random() > missing and CAMERA.contains(uv)]
        noisy += list(rng.uniform(0, 1023, (rng.poisson(false), 2)))
        rows += [(frame, uv, rotate(q, CAMERA.unproject(uv))) for uv in noisy]
    frame = np.array([row[0] for row in rows])
    count = len(rows)
    return Detections(frame, frame.astype(float), np.array([row[2] for row in rows]),
                      np.full(count, (SIGMA_PX * CAMERA.pixel_rad) ** 2),
                      np.array([row[1] for row in rows]), np.full(count, SIGMA_PX))


def test_objects_are_linked_among_false_centroids():
    objects = [(30, (300.0, 500.0), (1e-3, 2e-3, 0.0)), (30, (600.0, 400.0), (-2e-3, 0.0, 1e-3)),
               (120, (500.0, 500.0), (0.0, 3e-4, 4e-4))]
    found = scene(objects, false=2.0)
    tracklets = link_tracklets(found)
    middles = sorted(float(found.time_s[member].mean()) for member in tracklets)
    assert len(tracklets) == 3 and abs(middles[-1] - 120) < 20
    assert min(len(member) for member in tracklets) > 15
    for member in tracklets:
        assert (np.diff(found.frame[member]) > 0).all()


def test_hits_stars_and_hot_pixels_are_not_objects():
    star = rotate(attitude(50), CAMERA.unproject(np.array([400.0, 600.0])))
    for seed in range(3):
        assert not link_tracklets(scene(hot=[(200.0, 300.0), (700.5, 800.2)], stars=[star],
                                        false=2.0, seed=seed))


def test_few_or_no_detections_are_not_an_object():
    none = scene(false=0.0)
    assert not len(none.frame) and link_tracklets(none) == []
    short = scene([(5, (500.0, 500.0), (1e-3, 0.0, 0.0))], false=0.0, frames=4)
    assert link_tracklets(short) == []
