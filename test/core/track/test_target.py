# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A target is what no star explains and what moves against the stars."""

import numpy as np
import pytest
from skies import CAMERA, onboard_stars
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.catalog.apparent import ApparentSky
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, quaternion_from_pointing, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.target import TargetTracker, TargetTrackOptions

ONBOARD = onboard_stars(CAMERA, 2026.5, 9.0)
SIGMA_PX = 0.05
STEP_NS = 500_000_000
START = quaternion_from_pointing(*np.radians([80.0, 5.0, 20.0]))


class Sky:
    """Frames of a turning camera: stars to V 6.5, and spots on great circles or on pixels."""

    def __init__(self, *, turn_deg_s=(0.02, 0.05, 0.01), seed=1):
        self.rng = np.random.default_rng(seed)
        self.turn = np.radians(turn_deg_s)
        self.frame = 0

    def attitude(self):
        time_s = self.frame * STEP_NS * 1e-9
        q = multiply(START, quaternion_from_rotation_vector(self.turn * time_s))
        error = quaternion_from_rotation_vector(self.rng.normal(0, 1 * ARCSEC, 3))
        return q, AttitudeEstimate(multiply(q, error), np.eye(3) * ARCSEC ** 2, 20, np.empty(0),
                                   1.0)

    def update(self, tracker, spots, *, noise=0, windowed=False):
        """Show the next frame with spots on ICRF (K, 3); return the result of the tracker."""
        q, attitude = self.attitude()
        stars = ONBOARD.direction[ONBOARD.magnitude < 6.5]
        uv = CAMERA.project(rotate(conjugate(q), np.concatenate([stars, spots])))
        uv = uv[CAMERA.contains(uv)]
        uv = np.concatenate([uv, self.rng.uniform(0, 1023, (noise, 2))])
        uv = uv + self.rng.normal(0, SIGMA_PX, uv.shape)
        count = len(uv)
        self.stamp_ns = 10 ** 18 + self.frame * STEP_NS
        self.frame += 1
        return tracker.update(self.stamp_ns, attitude, Centroids(
            uv, np.full(count, 1e4), np.full(count, 50.0), np.full(count, SIGMA_PX)), windowed)


def moving(rate_deg_s, frame, *, aside_deg=0.0):
    """Return a direction near the boresight that moves along declination."""
    angle = np.radians(rate_deg_s) * frame * STEP_NS * 1e-9
    return rotate(quaternion_from_pointing(*np.radians([80.5 + aside_deg, 5.2, 0.0])),
                  [[0.0, -np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize('rate_deg_s', [0.004, 0.024, 0.3])
def test_target_is_found_and_measured(rate_deg_s):
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    said = []
    for frame in range(24):
        spot = moving(rate_deg_s, frame)
        q, _ = sky.attitude()
        place = CAMERA.project(rotate(conjugate(q), spot))[0]
        result = sky.update(tracker, spot, noise=5)
        said.append(result is not None)
        if result is not None:
            assert np.linalg.norm(result.centroid.uv[0] - place) < 6 * SIGMA_PX
            assert result.centroid.sigma_px[0] == SIGMA_PX
    assert not any(said[:4]) and said.count(True) >= 16
    # 3 sigma of a filter that is ready for manoeuvres.
    assert result.rate_deg_s == pytest.approx(rate_deg_s, abs=0.004)


def test_nothing_moves_nothing_is_said():
    """False spots everywhere, a star that no catalogue has, and a hot pixel."""
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    for _ in range(60):
        q, _ = sky.attitude()
        hot = rotate(q, CAMERA.unproject(np.array([[300.0, 200.0]])))
        unknown = moving(0.0, 0)
        assert sky.update(tracker, np.concatenate([hot, unknown]), noise=20) is None
        assert tracker.spots >= 20


def test_a_target_that_hides_for_a_while_stays_the_same():
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    frames = []
    for frame in range(30):
        hidden = 12 <= frame < 15
        result = sky.update(tracker, np.empty((0, 3)) if hidden else moving(0.05, frame))
        assert not (hidden and result)
        frames.append(0 if result is None else result.frames)
    assert frames[15] == frames[11] + 1


def test_the_first_of_two_is_the_target_until_it_leaves():
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    results = []
    for frame in range(40):
        spots = [moving(0.05, frame)] if frame < 25 else []
        if frame >= 8:
            spots.append(moving(-0.08, frame, aside_deg=1.0))
        results.append(sky.update(tracker, np.concatenate(spots)))
    assert all(a is not None and a.rate_deg_s == pytest.approx(0.05, rel=0.1)
               for a in results[10:25])
    assert results[-1] is not None and results[-1].rate_deg_s == pytest.approx(0.08, rel=0.1)


def test_a_slow_frame_or_none_at_all():
    tracker = TargetTracker(CAMERA, ApparentSky(ONBOARD), TargetTrackOptions())
    assert tracker.update(1, AttitudeEstimate(START, np.eye(3) * 1e-12, 5, np.empty(0), 1.0),
                          Centroids.empty()) is None
    nan = np.full(1, np.nan)
    assert tracker.update(2, AttitudeEstimate(START, np.eye(3) * 1e-12, 5, np.empty(0), 1.0),
                          Centroids(np.full((1, 2), np.nan), nan, nan, nan)) is None
    assert tracker.spots == 0


@pytest.mark.parametrize('rate_deg_s', [0.024, 0.3])
def test_a_target_is_predicted_in_the_next_image(rate_deg_s):
    """With an error that it states; a target that is hidden is less certain."""
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    normalised, sigma_px = [], []
    for frame in range(20):
        hidden = frame >= 16
        sky.update(tracker, np.empty((0, 3)) if hidden else moving(rate_deg_s, frame),
                   windowed=frame > 1)
        if frame < 2:
            continue
        predicted = tracker.predicted(sky.turn)
        q, _ = sky.attitude()
        seen = CAMERA.project(rotate(conjugate(q), moving(rate_deg_s, frame + 1)))[0]
        assert predicted.stars == 0 and predicted.hip.tolist() == [0]
        error_px = predicted.uv[0] + predicted.velocity[0] * STEP_NS * 1e-9 - seen
        normalised.append(np.linalg.norm(error_px) / predicted.sigma_px[0])
        sigma_px.append(predicted.sigma_px[0])
    assert max(normalised) < 4 and sigma_px[13] < 1
    assert (np.diff(sigma_px[13:]) > 0.1).all()


def test_a_target_that_leaves_the_image_is_no_longer_predicted():
    sky, tracker = Sky(turn_deg_s=(0.0, 1.2, 0.0)), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    inside, predicted = [], []
    for frame in range(13):
        q, _ = sky.attitude()
        seen = CAMERA.project(rotate(conjugate(q), moving(0.05, frame)))
        inside.append(CAMERA.contains(seen)[0])
        sky.update(tracker, moving(0.05, frame))
        predicted.append(len(tracker.predicted(sky.turn).hip))
    assert sum(inside) >= 8 and not inside[-1]
    assert predicted[2:] == [int(seen) for seen in inside[2:]]


def anywhere(sky, tracker):
    """Return whether the tracker wants the next image to be searched as a whole."""
    return (tracker.predicted(sky.turn).sigma_px >= 1024).any()


def test_a_second_whole_image_is_wanted_for_what_is_not_a_star():
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    nothing = np.empty((0, 3))
    wanted = []
    # The prediction of one frame comes too late for the next one.
    for spot, windowed in ((nothing, False), (nothing, True), (moving(0.0, 0), False),
                           (nothing, True), (moving(0.0, 0), False), (moving(0.0, 0), False),
                           (nothing, True), (nothing, False)):
        sky.update(tracker, spot, windowed=windowed)
        wanted.append(anywhere(sky, tracker))
    assert wanted == [False, False, True, True, True, False, False, False]


def test_a_faint_target_that_is_missed_is_searched_again():
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    for frame in range(4):
        sky.update(tracker, moving(0.004, frame), windowed=frame > 1)
        assert anywhere(sky, tracker) == (frame == 0)
    sky.update(tracker, np.empty((0, 3)), windowed=True)
    assert anywhere(sky, tracker)
    for frame in (5, 6):
        sky.update(tracker, moving(0.004, frame))
    assert not anywhere(sky, tracker)


def test_a_tracker_begins_anew_when_time_jumps_back():
    sky, tracker = Sky(), TargetTracker(CAMERA, ApparentSky(ONBOARD))
    for frame in range(10):
        found = sky.update(tracker, moving(0.05, frame))
    assert found is not None
    sky.frame = 3
    assert sky.update(tracker, moving(0.05, 3)) is None
    assert not (tracker.predicted(sky.turn).sigma_px < 1024).any()
