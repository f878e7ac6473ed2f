# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is read out of a bag: figures that are known, foreign and damaged bags."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_bag import (
    CAMERA, error_arcsec, FRAMES, PROTECTION_ARCSEC, protection_rad, RATE_RAD_S, SIGMA_ARCSEC,
    START_NS, STEP_NS, truth, UNSOLVED, write_run)
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.tools.report.panels import Panels, thinned
from startracker_ros.tools.report.summary import summarise
from std_msgs.msg import String

SOLVED = [frame for frame in range(FRAMES) if frame not in UNSOLVED]


def assert_whole(recording: Recording) -> None:
    np.testing.assert_array_equal(
        recording.attitude_ns, [START_NS + frame * STEP_NS for frame in SOLVED])
    stamps, error, sigma = recording.errors()
    np.testing.assert_array_equal(stamps, recording.attitude_ns)
    np.testing.assert_allclose(error, [error_arcsec(frame) for frame in SOLVED], atol=1e-6)
    np.testing.assert_allclose(sigma, np.tile(SIGMA_ARCSEC, (len(SOLVED), 1)), rtol=1e-9)


def test_figures_of_a_run(run: Path) -> None:
    recording = load_recording(run)
    assert recording.problems == () and recording.complete
    assert_whole(recording)
    assert recording.camera == CAMERA
    assert len(recording.image_ns) == len(recording.centroids) == len(recording.tracks) == FRAMES
    np.testing.assert_allclose(recording.rate_rad_s, np.tile(RATE_RAD_S, (len(SOLVED), 1)))
    np.testing.assert_array_equal(
        recording.without_attitude_ns, [START_NS + frame * STEP_NS for frame in UNSOLVED])
    np.testing.assert_allclose(recording.stage_ms('image_raw', 'centroids')[1], 12)
    np.testing.assert_allclose(recording.stage_ms('tracks', 'attitude')[1], 2)
    np.testing.assert_allclose(recording.latency_ms(), 19)
    assert {row.case: row.holds for row in summarise(recording)}['wrong attitudes']
    np.testing.assert_array_equal(
        recording.protection_rad, [protection_rad(frame) for frame in SOLVED])
    assert recording.beyond_protection() == (len(SOLVED), 0)


def test_errors_beyond_their_protection_level_do_not_hold(tmp_path: Path) -> None:
    def damage(topic: str, message: Any) -> Any:
        if topic == 'protection_level':
            if frame_of(message) == 40:
                return None
            message.vector.y = {50: abs(error_arcsec(50)[1]) * 0.99 * ARCSEC,
                                51: float('nan'), 52: -1.0}.get(frame_of(message), np.inf)
        return message
    recording = load_recording(write_run(tmp_path / 'run', change=damage))
    unknown = [SOLVED.index(frame) for frame in (40, 51, 52)]
    assert np.flatnonzero(np.isnan(recording.protection_rad[:, 1])).tolist() == unknown
    assert recording.beyond_protection() == (len(SOLVED) - 3, 1)
    problem, = recording.problems
    assert '/protection_level: 2 of 54 messages not used: protection level [' in problem
    row, = [row for row in summarise(recording) if 'protection' in row.case]
    assert (row.ours, row.holds) == (1, False)
    assert Panels(recording).key_figures()['errors beyond protection level'].low
    without = load_recording(write_run(tmp_path / 'none', leave_out=('protection_level',)))
    assert np.isnan(without.protection_rad).all() and without.beyond_protection() == (0, 0)
    assert not any('protection' in name for name in (
        *Panels(without).key_figures(), *(row.case for row in summarise(without))))


def test_panels_hold_the_figures(run: Path) -> None:
    panels = Panels(load_recording(run))
    assert panels.duration_s == pytest.approx((FRAMES - 1) * 0.1)
    assert [state['state'] for state in panels.states()] == [
        'LOST', 'ACQUIRING', 'TRACKING', 'LOST', 'ACQUIRING', 'TRACKING']
    assert panels.states()[3]['from'] == pytest.approx(3.0)
    bounds = [panel['series'][0] for panel in panels.errors()]
    assert {series['name'] for series in bounds} == {'protection level'}
    assert bounds[1]['y'][0] == pytest.approx(PROTECTION_ARCSEC[1])
    assert bounds[2]['y'][:2] == [None, pytest.approx(PROTECTION_ARCSEC[2])]
    right_ascension, declination, roll = panels.attitude()
    drawn, ours = (series['y'] for series in right_ascension['series'])
    assert np.abs(np.diff(drawn)).max() < 1, 'the jump from 360 to 0 must not be drawn'
    assert np.median(np.abs(np.array(ours) - np.array(drawn)[SOLVED])) < 0.01
    assert declination['series'][0]['y'][0] == pytest.approx(40.0)
    assert roll['series'][0]['y'][0] == pytest.approx(179.5)
    assert sum(panels.histograms()[0]['counts']) + panels.histograms()[0]['outside'] == len(SOLVED)
    assert sum(panels.histograms()[2]['expected']) == pytest.approx(len(SOLVED), rel=0.1)
    used, = [series['y'] for series in panels.stars()[0]['series']
             if series['name'] == 'seen and identified']
    tracked, = [series['y'] for series in panels.stars()[0]['series']
                if series['name'] == 'tracks']
    np.testing.assert_array_equal(used, np.array(tracked) - 2)
    assert panels.residuals()[0]['series'][1]['y'][5] == pytest.approx(0.25)
    assert panels.latency_rows()[0] == ('centroids', FRAMES, 12.0, 12.0, 12.0)


def stalled(topic: str, message: Any) -> Any:
    """Leave out what the stages send of the frames 10 to 24."""
    stages = ('centroids', 'tracks', 'attitude', 'attitude_cov', 'attitude_imu')
    return None if topic in stages and 10 <= frame_of(message) < 25 else message


def frame_of(message: Any) -> int:
    stamp_ns = message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec
    return (stamp_ns - START_NS) // STEP_NS


def test_tracking_without_attitude_is_shown(tmp_path: Path) -> None:
    def gap(topic: str, message: Any) -> Any:
        return None if topic == 'image_raw' and 10 <= frame_of(message) < 25 else (
            stalled(topic, message))
    for number, change in enumerate((stalled, gap)):
        panels = Panels(load_recording(write_run(tmp_path / str(number), change=change)))
        states = panels.states()
        assert [state['state'] for state in states] == [
            'LOST', 'ACQUIRING', 'TRACKING', 'TRACKING, no attitude', 'TRACKING', 'LOST',
            'ACQUIRING', 'TRACKING']
        assert [states[3]['from'], states[3]['to']] == pytest.approx([1.0, 2.5])


def test_states_without_any_topic_of_attitudes_are_drawn_as_they_are(tmp_path: Path) -> None:
    bag = write_run(tmp_path / 'run', leave_out=('attitude', 'attitude_cov', 'attitude_imu'))
    assert [state['state'] for state in Panels(load_recording(bag)).states()] == [
        'LOST', 'ACQUIRING', 'TRACKING', 'LOST', 'ACQUIRING', 'TRACKING']


def test_a_state_is_that_of_its_frame_however_late_it_is(tmp_path: Path) -> None:
    def delay_ns(topic: str, time_ns: int) -> int:
        """Stop the stages from 2 s to 4 s; then they catch up."""
        since_ns = time_ns - START_NS - 2 * 10 ** 9
        if topic in ('image_raw', 'camera_info', 'truth/attitude') or not (
                0 <= since_ns < 2 * 10 ** 9):
            return 0
        return 2 * 10 ** 9 - since_ns + since_ns // 1000
    states = Panels(load_recording(write_run(tmp_path / 'run', delay_ns=delay_ns))).states()
    assert [(state['state'], state['from']) for state in states[3:]] == [
        ('LOST', 3.0), ('ACQUIRING', 3.2), ('TRACKING', 3.3)]


def test_frames_that_were_lost_in_silence_do_not_hold(tmp_path: Path) -> None:
    said, silent = ('later frames without attitude, reason given',
                    'later frames without attitude, no reason')

    def reason(topic: str, message: Any) -> Any:
        if topic == '/diagnostics':
            message.status[0].name = 'attitude_estimator: attitude'
            message.status[0].message = 'no attitude: too few stars'
        return message
    rows = {row.case: row for row in summarise(load_recording(
        write_run(tmp_path / 'said', change=reason)), FRAMES)}
    assert (rows[said].ours, rows[silent].ours) == (3, 0)
    assert all(row.holds for row in rows.values()), rows
    rows = {row.case: row for row in summarise(load_recording(
        write_run(tmp_path / 'silent', change=lambda topic, message: reason(
            topic, stalled(topic, message)) if stalled(topic, message) else None)), FRAMES)}
    assert (rows[said].ours, rows[silent].ours) == (3, 15)
    assert {case for case, row in rows.items() if not row.holds} == {silent, 'frames dropped'}
    # An estimator that does not say why.
    rows = {row.case: row for row in summarise(load_recording(write_run(tmp_path / 'run')))}
    assert rows[silent].ours == 3 and not rows[silent].holds


def test_a_bag_that_is_not_whole_does_not_hold(run: Path, tmp_path: Path) -> None:
    rows = {row.case: row for row in summarise(load_recording(run), FRAMES + 1)}
    assert rows['frames missing in the bag'].ours == 1
    assert not rows['frames missing in the bag'].holds and not rows['images'].holds
    bag = write_run(tmp_path / 'run', change=lambda topic, message: String(data='no truth')
                    if topic == 'truth/attitude' else message)
    rows = {row.case: row for row in summarise(load_recording(bag))}
    assert rows['frames missing in the bag'].ours == FRAMES


def test_another_namespace_is_found_and_several_must_be_chosen_from(tmp_path: Path) -> None:
    bag = write_run(tmp_path / 'one', namespace='/fleet/tracker_1')
    recording = load_recording(bag)
    assert recording.namespace == 'fleet/tracker_1'
    assert_whole(recording)
    two = tmp_path / 'two'
    write_run(two, namespace='/a')
    (two / 'two.mcap').rename(two / 'two_0.mcap')
    (write_run(tmp_path / 'other', namespace='/b') / 'other.mcap').rename(two / 'two_1.mcap')
    with pytest.raises(BagError, match="several star trackers.*'a', 'b'"):
        load_recording(two)
    assert_whole(load_recording(two, 'b'))


@pytest.mark.parametrize('left_out', [
    ('attitude',), ('attitude', 'attitude_cov'), ('attitude_imu',)])
def test_any_of_the_attitude_topics_is_enough(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    assert_whole(load_recording(write_run(tmp_path / 'run', leave_out=left_out)))


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    def damage(topic: str, message: Any) -> Any:
        if topic == 'attitude_cov':
            return String(data='no pose')
        if topic == 'attitude':
            message.quaternion.x = float('nan')
        if topic == 'tracks' and message.header.stamp.sec % 2:
            message.fields[0].datatype = 8
        if topic == 'camera_info':
            message.k[0] = -1.0
        return message
    recording = load_recording(write_run(tmp_path / 'run', change=damage))
    assert_whole(recording)
    problems = '\n'.join(recording.problems)
    for words in ("/attitude_cov: 55 of 55 messages not used: type 'std_msgs/msg/String' is not",
                  '/attitude: 55 of 55 messages not used: quaternion [nan,',
                  "/tracks: 30 of 60 messages not used: cloud field 'x' has datatype 8",
                  '/camera_info: 60 of 60 messages not used: '):
        assert words in problems
    assert recording.camera is None and len(recording.tracks) == 30


def test_absurd_covariances_and_rates_are_not_known(tmp_path: Path) -> None:
    def damage(topic: str, message: Any) -> Any:
        if topic == 'attitude_cov':
            message.pose.covariance[21] = 1e300
        if topic == 'attitude_imu' and message.orientation_covariance[0] != -1:
            message.orientation_covariance[4] = -1.0
            message.angular_velocity.z = float('inf')
        return message
    recording = load_recording(write_run(tmp_path / 'run', change=damage))
    assert len(recording.attitude_ns) == len(SOLVED)
    assert np.isnan(recording.covariance_sensor).all() and np.isnan(recording.rate_rad_s).all()


def test_what_is_whole_of_a_cut_bag_is_read(run: Path, tmp_path: Path) -> None:
    data = next(run.glob('*.mcap')).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[:len(data) // 2])
    recording = load_recording(cut)
    assert not recording.complete
    assert 'was not finished' in recording.problems[0]
    for content in b'', b'PK\3\4' + bytes(100):
        cut.write_bytes(content)
        with pytest.raises(BagError, match='not an MCAP file'):
            load_recording(cut)


def test_truth_is_the_one_of_the_stamp(run: Path) -> None:
    recording = load_recording(run)
    np.testing.assert_allclose(
        np.abs(np.sum(recording.truth_quaternion * [truth(frame) for frame in range(FRAMES)],
                      axis=1)), 1)


def test_thinning_keeps_ends_and_extremes() -> None:
    values = np.random.default_rng(3).normal(size=100_000)
    values[7777], values[50_000:50_100] = 99.0, np.nan
    keep = thinned([values], 1000)
    assert len(keep) <= 1002 and np.all(np.diff(keep) > 0)
    assert {0, 7777, 99_999, int(np.nanargmin(values))} <= set(keep.tolist())
    np.testing.assert_array_equal(thinned([values[:50]], 50), np.arange(50))


@pytest.mark.parametrize('stamp_ns, text', [
    (0, '1970-01-01T00:00:00.000'), (-1, '1969-12-31T23:59:59.999'),
    (1_790_000_000_123_999_999, '2026-09-21T14:13:20.123')])
def test_utc(stamp_ns: int, text: str) -> None:
    assert utc(stamp_ns) == text
