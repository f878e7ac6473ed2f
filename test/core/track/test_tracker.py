# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker in steady turns, with dropouts, false points, wrong names and broken clocks."""

from dataclasses import dataclass, replace

from chi_square import check_mean
import numpy as np
import pytest
from star_motion import CAMERA, Motion, sky, START_NS, STEP_NS
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    attitude_error, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.registry import MODELS
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter
from startracker_ros.core.track.tracks import Hint

ONBOARD = sky()
ELSEWHERE_DEG = (200.0, -40.0, 10.0)
FILTERS = ['attitude', 'constant_velocity', 'coordinated_turn']


@dataclass
class Swing(Motion):
    """A camera that swings to and fro about its y axis, pulsation in rad/s."""

    swing_deg: float = 0.0
    pulsation: float = 0.0

    def q(self, frame):
        angle = np.radians(self.swing_deg) * np.cos(self.pulsation * frame * STEP_NS * 1e-9)
        return multiply(self.q_start, quaternion_from_rotation_vector([0.0, angle, 0.0]))


def run(tracker, motion, frames):
    """Feed the frames, each of them identified until the tracker tracks; yield (k, tracks)."""
    for k in frames:
        stamp_ns, centroids, hip = motion.frame(k)
        tracks = tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, hip)
        yield k, tracks


def tracking(motion, frames=10, **options):
    """Return a tracker that has tracked a motion for some frames."""
    tracker = TrackFilter(motion.camera, motion.onboard, TrackerOptions(**options))
    for _ in run(tracker, motion, range(frames)):
        pass
    assert tracker.state is TrackerState.TRACKING, tracker.reason
    return tracker


def consistency(tracker, truth):
    """Return the error (3,) of the attitude in rad, and its square over the covariance."""
    attitude = tracker.attitude.attitude
    error = attitude_error(attitude.quaternion, truth)
    return error, error @ np.linalg.solve(attitude.covariance_sensor, error)


def worst_px(motion, k, tracks):
    """Return the largest distance of a usable track from its true place."""
    used = tracks.usable
    error = tracks.uv[used] - motion.place(k, tracks.hip[used])
    return np.hypot(*error.T).max(initial=0.0)


def test_two_identifications_start_tracking():
    motion = Motion(ONBOARD, (0.1, 0.2, 0.3))
    tracker = TrackFilter(CAMERA, ONBOARD)
    assert tracker.state is TrackerState.LOST and tracker.state.value == 'LOST'
    frame = motion.frame(0)
    assert len(tracker.update(*frame[:2])) == 0
    tracker.identified(*frame)
    assert tracker.state is TrackerState.ACQUIRING
    tracker.identified(*frame)
    assert tracker.state is TrackerState.ACQUIRING
    frame = motion.frame(1)
    assert len(tracker.update(*frame[:2])) == 0
    tracker.identified(*frame)
    assert tracker.state is TrackerState.TRACKING
    assert tracker.stars_matched > 20 and 'identified' in tracker.reason
    stamp_ns, centroids, hip = motion.frame(2)
    tracks = tracker.update(stamp_ns, centroids)
    assert np.all(tracks.usable) and set(tracks.hip) <= set(hip)
    assert worst_px(motion, 2, tracks) < 0.5
    assert tracker.frames_since_fix == 0 and tracker.residual_px < 0.3
    np.testing.assert_allclose(np.median(np.hypot(*tracks.velocity.T)), 0.2236 * 85, rtol=0.1)


def test_identification_may_come_late_or_early():
    motion = Motion(ONBOARD, (0.0, 0.5, 0.0))
    frames = [motion.frame(k) for k in range(12)]
    late, early = TrackFilter(CAMERA, ONBOARD), TrackFilter(CAMERA, ONBOARD)
    for k in range(12):
        if k in (3, 5):
            early.identified(*frames[k])
        from_early = early.update(*frames[k][:2])
        from_late = late.update(*frames[k][:2])
        if k in (8, 10):
            late.identified(*frames[k - 5])
    assert late.state is early.state is TrackerState.TRACKING
    assert len(from_late) > 20 and worst_px(motion, 11, from_late) < 0.3
    # The frames since the late identification are processed: the tracks are the same.
    hip, in_late, in_early = np.intersect1d(from_late.hip, from_early.hip, return_indices=True)
    assert len(hip) > 20
    np.testing.assert_allclose(from_late.uv[in_late], from_early.uv[in_early], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize('model', FILTERS)
@pytest.mark.parametrize('rate_deg_s', [(0, 0, 0), (0.05, 0.1, 0.02), (0, 1, 0), (0, 0, 1)])
def test_filtered_attitude_is_consistent_unbiased_and_better_than_one_frame(rate_deg_s, model):
    motion = Motion(ONBOARD, rate_deg_s, false_points=5, missed=0.05)
    tracker = tracking(motion, 30, model=model)
    nees, filtered, single, error_px, position_nees = [], [], [], [], []
    for k in range(30, 180):
        stamp_ns, centroids, hip = motion.frame(k)
        tracks = tracker.update(stamp_ns, centroids)
        assert tracker.state is TrackerState.TRACKING, tracker.reason
        used = tracks.usable
        error, squared = consistency(tracker, motion.q(k))
        nees.append(squared)
        filtered.append(error)
        known = hip > 0
        of_frame = estimate_attitude(
            CAMERA.unproject(centroids.uv[known]), ONBOARD.direction[ONBOARD.index_of(hip[known])],
            np.full(known.sum(), CAMERA.pixel_rad))
        single.append(attitude_error(of_frame.quaternion, motion.q(k)))
        offset = tracks.uv[used] - motion.place(k, tracks.hip[used])
        error_px.extend(offset)
        # The stars of a frame share its attitude.
        position_nees.append(np.einsum(
            'ni,nij,nj->n', offset, np.linalg.inv(tracks.covariance[used]), offset).mean())
    # Conservative by as much as the model allows for manoeuvres that do not happen here.
    check_mean(3, nees, inflation=2.0)
    check_mean(2, position_nees, inflation=2.0)
    assert np.abs(np.mean(error_px, axis=0)).max() < 0.02
    rms = np.sqrt(np.mean(np.square(filtered), axis=0) / np.mean(np.square(single), axis=0))
    assert rms.max() < 0.8


def test_curved_paths_are_tracked_without_lag():
    """At 1 deg/s of roll a star 600 px from the centre is pushed by 0.18 px/s^2."""
    motion = Motion(ONBOARD, (0.0, 0.0, 1.0), sigma_px=0.05)
    tracker = tracking(motion, 30, acceleration_deg_s2=0.001)
    inward = []
    for k in range(30, 120):
        tracks = tracker.update(*motion.frame(k)[:2])
        truth = motion.place(k, tracks.hip)
        arm = truth - [CAMERA.cx, CAMERA.cy]
        far = tracks.usable & (np.hypot(*arm.T) > 400)
        inward.extend(np.sum((tracks.uv - truth) * arm, axis=1)[far] / np.hypot(*arm[far].T))
    assert abs(np.mean(inward)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize('model', FILTERS)
@pytest.mark.parametrize('sigma_per_magnitude', [0.0, 0.3])
def test_attitude_is_consistent_under_acceleration(sigma_per_magnitude, model):
    """The body rate swings, its peak acceleration the 1 sigma that the options allow for."""
    options = TrackerOptions()
    pulsation = 2 * np.pi / 30
    motion = Swing(ONBOARD, swing_deg=options.acceleration_deg_s2 / pulsation ** 2,
                   pulsation=pulsation, false_points=5,
                   sigma_per_magnitude=sigma_per_magnitude)
    tracker, nees = tracking(motion, 20, model=model), []
    for k in range(20, 320):
        tracker.update(*motion.frame(k)[:2])
        nees.append(consistency(tracker, motion.q(k))[1])
    # On average the acceleration is less than its peak.
    check_mean(3, nees, inflation=2.0)


def test_distorted_lens():
    camera = Camera(1200, 900, 4000.0, 4010.0, 610.0, 440.0, (-0.3, 0.5, 1e-3, -2e-3, 0.0))
    onboard = sky(6.0, camera)
    motion = Motion(onboard, (0.3, 0.6, 0.5), camera=camera)
    tracker = tracking(motion, 20)
    for k, tracks in run(tracker, motion, range(20, 60)):
        assert tracks.usable.sum() > 10 and worst_px(motion, k, tracks) < 0.6
    assert tracker.residual_px < 0.2


@pytest.mark.parametrize('model', MODELS)
def test_stars_enter_and_leave(model):
    motion = Motion(ONBOARD, (0.0, 1.0, 0.0), false_points=5)
    tracker = tracking(motion, 3, model=model)
    first = set(motion.frame(2)[2]) - {0}
    owner = {}
    for k, tracks in run(tracker, motion, range(3, 160)):
        assert worst_px(motion, k, tracks) < 0.6
        assert CAMERA.contains(tracks.uv, -1.0).all()
        for track, hip in zip(tracks.track_id[tracks.hip > 0], tracks.hip[tracks.hip > 0]):
            assert owner.setdefault(track, hip) == hip
        assert len(np.unique(tracks.hip[tracks.hip > 0])) == np.count_nonzero(tracks.hip)
    # 16 deg on, none of the first stars is left, and the new ones are as many.
    now = set(tracks.hip[tracks.usable])
    assert tracker.state is TrackerState.TRACKING
    assert len(now) > 15 and not now & first


def test_new_stars_count_only_after_some_frames():
    motion = Motion(ONBOARD, (0.0, 0.0, 0.0))
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(confirm_frames=4))
    for k in (0, 1):
        stamp_ns, centroids, hip = motion.frame(k)
        tracker.update(stamp_ns, centroids)
        tracker.identified(stamp_ns, centroids, np.where(np.arange(len(hip)) < 8, hip, 0))
    usable = [tracker.update(*motion.frame(k)[:2]).usable.sum() for k in range(2, 9)]
    assert usable[:4] == [8] * 4 and usable[4] > 25


def test_few_stars_that_come_and_go_in_a_fast_turn_are_not_a_loss():
    sparse = sky(5.6)
    published, losses = 0, 0
    for seed in range(4):
        motion = Motion(sparse, (0.0, 9.0, 0.0), (84.0, 5.0, 30.0 * seed), missed=0.2, seed=seed)
        tracker = tracking(motion, 2)
        for k, _ in run(tracker, motion, range(2, 100)):
            losses += tracker.state is not TrackerState.TRACKING
            if tracker.attitude is not None:
                published += 1
                error, _ = consistency(tracker, motion.q(k))
                sigma = np.sqrt(np.diag(tracker.attitude.attitude.covariance_sensor))
                assert (np.abs(error) < 5 * sigma).all()
    assert losses == 0 and published > 0.9 * 4 * 98


def after_twelve_frames(motion):
    """Return a tracker, stamp and centroids of frame 13, the mask and hip of stars it follows."""
    tracker = tracking(motion, 12, max_stars=12)
    followed = tracker.update(*motion.frame(12)[:2]).hip
    stamp_ns, centroids, hip = motion.frame(13)
    return tracker, stamp_ns, centroids, np.isin(hip, followed), followed


def test_other_stars_than_those_followed_are_used_where_they_are_as_predicted():
    motion = Motion(ONBOARD, (0.0, 4.0, 0.0))
    for shift_px, trusted in ((None, True), (60.0, False)):
        tracker, stamp_ns, centroids, mine, followed = after_twelve_frames(motion)
        if shift_px is None:
            centroids = centroids.select(~mine)
        else:
            # A second image next to it: not all stars are where the others have them.
            centroids.uv[mine] += [0.0, shift_px]
        tracks = tracker.update(stamp_ns, centroids)
        assert (tracker.attitude is not None) == trusted
        assert tracker.state is TrackerState.TRACKING
        if trusted:
            assert 'where the tracks before had them' in tracker.reason
            assert not np.isin(tracks.hip, followed).any() and worst_px(motion, 13, tracks) < 0.6
            assert consistency(tracker, motion.q(13))[1] < 25


def test_other_stars_are_not_used_where_those_followed_are_elsewhere_or_cannot_have_left():
    for rate_deg_s, away_px in ((0.5, None), (4.0, 5.0)):
        motion = Motion(ONBOARD, (0.0, rate_deg_s, 0.0))
        tracker, stamp_ns, centroids, mine, _ = after_twelve_frames(motion)
        if away_px is None:
            centroids = centroids.select(~mine)
        else:
            centroids.uv[mine] += np.random.default_rng(1).normal(0, away_px, (mine.sum(), 2))
        tracker.update(stamp_ns, centroids)
        assert tracker.attitude is None and tracker.state is TrackerState.TRACKING


def test_a_start_by_its_own_prediction_does_not_count_against_a_hint():
    motion = Motion(ONBOARD, (0.0, 4.0, 0.0))
    tracker, stamp_ns, centroids, mine, _ = after_twelve_frames(motion)
    tracker.update(stamp_ns, centroids.select(~mine))
    assert 'where the tracks before had them' in tracker.reason
    tracker.update(stamp_ns + 6 * 10 ** 9, Centroids.empty())
    assert tracker.state is TrackerState.LOST
    stamp_ns, centroids, hip = motion.frame(80)
    tracker.add_hint(Hint(stamp_ns, motion.q(80), np.eye(3) * 1e-8,
                          np.radians(motion.rate_deg_s), np.eye(3) * 1e-8))
    tracker.update(stamp_ns, centroids)
    tracker.identified(stamp_ns, centroids, hip)
    assert tracker.state is TrackerState.TRACKING and 'a hint has them' in tracker.reason


def test_crowded_stars_are_left_alone():
    crowded = replace(ONBOARD, crowded=ONBOARD.crowded | (np.arange(len(ONBOARD)) % 2 == 0))
    motion = Motion(crowded)
    tracker = tracking(motion, 12)
    tracks = tracker.update(*motion.frame(12)[:2])
    place = crowded.index_of(tracks.hip)
    assert len(tracks) > 8 and not crowded.crowded[place].any()


def test_stars_fainter_than_the_limit_are_not_followed():
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 12, magnitude_limit=5.0)
    tracks = tracker.update(*motion.frame(12)[:2])
    for hip in (tracks.hip, tracker.predicted.hip):
        assert len(hip) > 4 and (ONBOARD.magnitude[ONBOARD.index_of(hip)] <= 5.0).all()


def test_the_number_of_stars_is_limited():
    motion = Motion(ONBOARD, (0.0, 0.5, 0.0))
    tracker = tracking(motion, 3, max_stars=12)
    for _, tracks in run(tracker, motion, range(3, 60)):
        assert len(tracks) <= 12
    assert tracks.usable.sum() > 8


@pytest.mark.parametrize('model', MODELS)
def test_false_points_and_missed_stars(model):
    motion = Motion(ONBOARD, (0.1, 0.1, 0.1), false_points=20, missed=0.2)
    tracker = tracking(motion, 10, model=model)
    for k, tracks in run(tracker, motion, range(10, 150)):
        assert tracker.state is TrackerState.TRACKING and worst_px(motion, k, tracks) < 0.7
        missed = tracks.missed > 0
        assert np.isnan(tracks.residual_px[missed]).all() and not tracks.usable[missed].any()
        assert (tracks.association_probability[~missed] > 0.5).all()
    assert tracks.usable.sum() > 12


@pytest.mark.parametrize('model', MODELS)
def test_short_dropout_is_bridged_a_long_one_is_not(model):
    motion = Motion(ONBOARD, (0.1, 0.2, 0.0))
    tracker = tracking(motion, 30, max_gap_s=0.5, model=model)
    for k in (30, 31, 32):
        tracks = tracker.update(START_NS + k * STEP_NS, Centroids.empty())
        assert len(tracks) > 20 and not tracks.usable.any()
        assert tracker.frames_since_fix == k - 29
    tracks = tracker.update(*motion.frame(33)[:2])
    assert tracks.usable.sum() > 20 and worst_px(motion, 33, tracks) < 0.6
    assert tracker.frames_since_fix == 0
    for k in range(34, 40):
        tracks = tracker.update(START_NS + k * STEP_NS, Centroids.empty())
    assert tracker.state is TrackerState.LOST and 'no stars for 0.6 s' in tracker.reason
    assert len(tracks) == 0 and tracker.stars_matched == 0 and np.isnan(tracker.residual_px)


def test_limits_change_without_loss_of_lock():
    motion = Motion(ONBOARD, (0.1, 0.2, 0.0))
    tracker = tracking(motion, 30, max_gap_s=5.0)
    before = tracker.update(*motion.frame(30)[:2])
    tracker.set_limits(TrackerOptions(max_gap_s=0.5, max_missed=200))
    after = tracker.update(*motion.frame(31)[:2])
    assert tracker.state is TrackerState.TRACKING
    assert len(set(after.track_id) & set(before.track_id)) > 20
    for k in range(32, 38):
        tracker.update(START_NS + k * STEP_NS, Centroids.empty())
    assert tracker.state is TrackerState.LOST and 'no stars for 0.6 s' in tracker.reason


def test_star_that_disappears_is_dropped_and_acquired_again():
    motion = Motion(ONBOARD, (0.0, 0.1, 0.0))
    tracker = tracking(motion, 20, max_missed=4, confirm_frames=3)
    star = motion.frame(0)[2][3]
    history = []
    for k in range(20, 40):
        stamp_ns, centroids, hip = motion.frame(k)
        lit = (hip != star) | (k >= 28) & (k != 29)
        tracks = tracker.update(stamp_ns, Centroids(
            centroids.uv[lit], centroids.flux[lit], centroids.snr[lit], centroids.sigma_px[lit]))
        history.append(''.join(str(m) for m in tracks.missed[tracks.hip == star]))
        near = np.hypot(*(tracks.uv - motion.place(k, np.array([star]))).T) < 3
        # Detected once and then missed, an unconfirmed track is dropped before it is published.
        assert near.sum() == (k < 24 or k >= 31)
    assert history == ['1', '2', '3', '4'] + [''] * 9 + ['0'] * 7


@pytest.mark.parametrize('model', MODELS)
def test_frame_with_too_few_stars_identifies_none(model):
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 20, model=model)
    stamp_ns, centroids, _ = motion.frame(20)
    few = Centroids(*(getattr(centroids, name)[:3] for name in (
        'uv', 'flux', 'snr', 'sigma_px')))
    tracks = tracker.update(stamp_ns, few)
    assert len(tracks) > 20 and not tracks.hip.any()
    assert np.isnan(tracks.magnitude).all() and not tracks.usable.any()
    assert tracker.update(*motion.frame(21)[:2]).usable.sum() > 20


@pytest.mark.parametrize('model', MODELS)
def test_kidnapped_camera_is_lost_and_acquired_again(model):
    motion, other = Motion(ONBOARD, (0.1, 0.2, 0.0)), Motion(
        ONBOARD, pointing_deg=ELSEWHERE_DEG, false_points=100, seed=1)
    tracker = tracking(motion, 20, model=model)
    for k in range(20, 25):
        assert tracker.state is TrackerState.TRACKING
        assert not tracker.update(*other.frame(k)[:2]).usable.any()
    assert tracker.state is TrackerState.LOST
    for k, tracks in run(tracker, other, range(25, 35)):
        assert worst_px(other, k, tracks) < 0.6
    assert tracker.state is TrackerState.TRACKING and tracks.usable.sum() > 10


@pytest.mark.parametrize('model', MODELS)
def test_star_that_leaves_the_common_rotation_is_dropped(model):
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 20, model=model)
    star = motion.frame(0)[2][3]
    track = None
    for k in range(20, 60):
        stamp_ns, centroids, hip = motion.frame(k)
        # Slow enough to stay inside its gate: only the common rotation excludes it.
        offset_px = 0.05 * (k - 19)
        centroids.uv[hip == star] += [offset_px, 0.0]
        tracks = tracker.update(stamp_ns, centroids)
        mine = tracks.hip == star
        if track is None:
            track = tracks.track_id[mine][0]
        assert not tracks.usable[mine].any() or offset_px < 0.8
    assert track not in tracks.track_id
    assert tracker.state is TrackerState.TRACKING and tracker.residual_px < 0.2


def test_contradicting_identification_drops_all_tracks():
    motion, other = Motion(ONBOARD), Motion(ONBOARD, pointing_deg=ELSEWHERE_DEG)
    tracker = tracking(motion, 20)
    tracker.identified(*motion.frame(19))
    assert tracker.state is TrackerState.TRACKING
    tracker.identified(*other.frame(19))
    assert tracker.state is TrackerState.ACQUIRING and 'contradicts' in tracker.reason
    # The next right one does not confirm the wrong one; two right ones start the tracks.
    for k in (20, 21):
        assert len(tracker.update(*motion.frame(k)[:2])) == 0
        tracker.identified(*motion.frame(k))
    assert tracker.state is TrackerState.TRACKING
    assert worst_px(motion, 22, tracker.update(*motion.frame(22)[:2])) < 0.6


@pytest.mark.parametrize('model', MODELS)
def test_tracks_of_a_wrong_start_are_dropped(model):
    """Two identifications agree with each other, but not with what the camera sees next."""
    motion, other = Motion(ONBOARD), Motion(ONBOARD, pointing_deg=ELSEWHERE_DEG)
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(model=model))
    for k in (0, 1):
        tracker.update(*motion.frame(k)[:2])
        tracker.identified(*other.frame(k))
    assert tracker.state is TrackerState.TRACKING
    for k in range(2, 7):
        assert tracker.state is TrackerState.TRACKING
        assert not tracker.update(*motion.frame(k)[:2]).usable.any()
        assert tracker.attitude is None
    assert tracker.state is TrackerState.LOST
    for k, tracks in run(tracker, motion, range(7, 12)):
        assert worst_px(motion, k, tracks) < 0.6
    assert tracker.state is TrackerState.TRACKING


def test_identification_that_does_not_fit_the_catalogue_is_ignored():
    motion = Motion(ONBOARD)
    tracker = TrackFilter(CAMERA, ONBOARD)
    stamp_ns, centroids, hip = motion.frame(0)
    tracker.update(stamp_ns, centroids)
    tracker.identified(stamp_ns, centroids, np.random.default_rng(0).permutation(hip))
    tracker.identified(stamp_ns, centroids, np.zeros_like(hip))
    tracker.identified(stamp_ns, centroids, np.where(np.arange(len(hip)) < 3, hip, 0))
    tracker.identified(stamp_ns, Centroids.empty(), np.empty(0, int))
    assert tracker.state is TrackerState.LOST
    # A few wrong names among many right ones do no harm.
    hip = hip.copy()
    hip[:3] = hip[3:6]
    tracker.identified(stamp_ns, centroids, hip)
    assert tracker.state is TrackerState.ACQUIRING


def test_star_identified_twice_is_tracked_once():
    motion = Motion(ONBOARD)
    tracker = TrackFilter(CAMERA, ONBOARD)
    for k in (0, 1):
        stamp_ns, centroids, hip = motion.frame(k)
        twice = np.append(np.arange(len(hip)), 0)
        ghost = Centroids(centroids.uv[twice], centroids.flux[twice], centroids.snr[twice],
                          centroids.sigma_px[twice])
        ghost.uv[-1] += 0.2
        tracker.identified(stamp_ns, ghost, hip[twice])
    tracks = tracker.update(stamp_ns, centroids)
    assert len(np.unique(tracks.hip)) == len(tracks) > 20


def test_two_identifications_too_fast_for_the_camera():
    motion, other = Motion(ONBOARD), Motion(ONBOARD, pointing_deg=(86.0, 5.0, 30.0))
    tracker = TrackFilter(CAMERA, ONBOARD)
    tracker.identified(*motion.frame(0))
    tracker.identified(*other.frame(1))
    assert tracker.state is TrackerState.ACQUIRING and 'deg/s' in tracker.reason


@pytest.mark.parametrize('model', MODELS)
def test_irregular_stamps(model):
    motion = Motion(ONBOARD, (0.2, 0.3, 0.4))
    tracker = tracking(motion, 20, model=model)
    for k in np.cumsum([20, 0.3, 0.5, 2.0, 1.0, 7.0, 1.0, 0.2]):
        tracks = tracker.update(*motion.frame(k)[:2])
        assert tracks.usable.sum() > 20 and worst_px(motion, k, tracks) < 0.6


def test_late_frames_are_rejected_and_counted():
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 20)
    assert tracker.update(*motion.frame(19)[:2]) is None
    assert tracker.update(*motion.frame(12)[:2]) is None
    assert tracker.late_frames == 2 and tracker.state is TrackerState.TRACKING
    assert len(tracker.update(*motion.frame(20)[:2])) > 20


def test_time_jumps():
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 10)
    assert len(tracker.update(*motion.frame(70)[:2])) == 0
    assert tracker.state is TrackerState.LOST and 'no stars' in tracker.reason
    for _ in run(tracker, motion, range(71, 80)):
        pass
    assert tracker.state is TrackerState.TRACKING
    assert len(tracker.update(*motion.frame(5)[:2])) == 0
    assert tracker.state is TrackerState.LOST and 'jumped back' in tracker.reason
    # A late identification from before the jump does not delay the new start.
    tracker.identified(*motion.frame(79))
    *_, (_, tracks) = run(tracker, motion, range(6, 12))
    assert tracker.state is TrackerState.TRACKING and worst_px(motion, 11, tracks) < 0.6


def test_no_second_identification():
    motion = Motion(ONBOARD)
    tracker = TrackFilter(CAMERA, ONBOARD, TrackerOptions(max_gap_s=2.0))
    tracker.identified(*motion.frame(0))
    for k in range(25):
        tracker.update(*motion.frame(k)[:2])
    assert tracker.state is TrackerState.LOST and 'second' in tracker.reason


def test_useless_centroids_are_rejected():
    motion = Motion(ONBOARD, (0.1, 0.2, 0.3))
    clean, dirty = tracking(motion, 10), tracking(replace(motion), 10)
    stamp_ns, good, hip = motion.frame(10)
    bad = Centroids(uv=np.array([[np.nan, 3], [5, np.inf], [100, 100], [200, 200]]),
                    flux=np.full(4, 1e4), snr=np.full(4, 9.0),
                    sigma_px=np.array([0.1, 0.1, np.nan, -0.1]))
    both = Centroids(*(np.concatenate([getattr(bad, name), getattr(good, name)])
                       for name in ('uv', 'flux', 'snr', 'sigma_px')))
    expected, tracks = clean.update(stamp_ns, good), dirty.update(stamp_ns, both)
    assert dirty.rejected_centroids == 4
    np.testing.assert_array_equal(tracks.uv, expected.uv)
    dirty.identified(stamp_ns, both, np.append([7, 8, 9, 10], hip))
    assert dirty.state is TrackerState.TRACKING


def test_reset():
    motion = Motion(ONBOARD)
    tracker = tracking(motion, 10)
    tracker.reset()
    assert tracker.state is TrackerState.LOST and 'waiting' in tracker.reason
    *_, (_, tracks) = run(tracker, motion, range(5, 12))
    assert len(tracks) > 20


def test_same_input_same_output():
    one, two = (
        tracking(Motion(ONBOARD, (0.1, 0.2, 0.3), false_points=5), 30) for _ in range(2))
    frame = Motion(ONBOARD, (0.1, 0.2, 0.3), false_points=5).frame(30)
    np.testing.assert_array_equal(one.update(*frame[:2]).uv, two.update(*frame[:2]).uv)
