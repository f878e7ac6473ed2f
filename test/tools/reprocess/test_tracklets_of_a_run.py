# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tracklets of a run as Tracking Data Message, and located by two observers."""

import shutil

from ccsds_ndm import Tdm
import numpy as np
import pytest
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.io.export.tdm import tdm_text, TrackletAngles
from startracker_ros.sim.flights.bags import write_bag
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE
from startracker_ros.tools.reprocess.tables import open_run
from startracker_ros.tools.reprocess.tracklets import _located, _read, _Tracklet, tracklets

STAMP_NS = 1_767_225_600_000_000_000


def observed(tracker, number, position_m, target_m, target_m_s, seconds, seed=0):
    """Return the tracklet of a target that an observer with a velocity sees each second."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(seconds, TRACKLET_DTYPE)
    velocity_m_s = np.array([0.0, 7000.0, 1000.0])
    for k, row in enumerate(rows):
        own = position_m + velocity_m_s * k
        line = target_m + target_m_s * k - own
        line = line - target_m_s * (np.linalg.norm(line) / 299_792_458.0)
        apparent = aberrate((line / np.linalg.norm(line))[None], velocity_m_s)[0]
        row['stamp_ns'], row['tracklet'] = STAMP_NS + k * 10 ** 9, number
        row['ra_deg'] = np.degrees(np.arctan2(apparent[1], apparent[0])) % 360
        row['dec_deg'] = np.degrees(np.arcsin(apparent[2])) + rng.normal(0, 3 / 3600)
        row['cov_ee_arcsec2'] = row['cov_nn_arcsec2'] = 9.0
        for axis, p, v in zip('xyz', own, velocity_m_s):
            row[f'position_{axis}_m'], row[f'velocity_{axis}_m_s'] = p, v
    return _Tracklet(tracker, number, rows)


def test_two_observers_locate_one_object_and_not_another():
    target, motion = np.array([7.2e6, 3e5, 2e5]), np.array([100.0, 7400.0, -500.0])
    first, second = np.array([6.9e6, 0.0, 0.0]), np.array([6.9e6, 1e5, 5e4])
    other = np.array([7.1e6, 4e5, -3e5])
    located = _located({
        'sat_1': [observed('sat_1', 1, first, target, motion, 12),
                  observed('sat_1', 2, first, other, motion, 12)],
        'sat_2': [observed('sat_2', 5, second, target, motion, 12, seed=1)]})
    assert located['sat_1_1'][0] == 'sat_2_5' and 'sat_1_2' not in located
    assert located['sat_1_1'][1] == pytest.approx(np.linalg.norm(target - first), rel=0.03)
    # Two heads of one satellite have no baseline.
    assert not _located({'head_1': [observed('head_1', 1, first, target, motion, 12)],
                         'head_2': [observed('head_2', 1, first, target, motion, 12)]})


def test_the_message_has_the_keywords_of_the_standard():
    stamps = np.array([STAMP_NS, STAMP_NS + 10 ** 9])
    text = tdm_text('HEAD', 'ME', [TrackletAngles(
        'T1', stamps, np.array([359.999999999, 10.5]), np.array([-0.0, -45.25]),
        np.tile(4 * np.eye(2), (2, 1, 1)), np.array([7.1, np.nan]))], STAMP_NS)
    lines = text.split('\n')
    assert lines[0] == 'CCSDS_TDM_VERS = 2.0'
    keys = [line.split(' = ')[0] for line in lines if ' = ' in line]
    assert keys[:12] == [
        'CCSDS_TDM_VERS', 'CREATION_DATE', 'ORIGINATOR', 'TRACK_ID', 'TIME_SYSTEM', 'START_TIME',
        'STOP_TIME', 'PARTICIPANT_1', 'PARTICIPANT_2', 'MODE', 'PATH', 'ANGLE_TYPE']
    assert 'ANGLE_1 = 2026-01-01T00:00:00.000000000 0.00000000' in text
    assert 'ANGLE_2 = 2026-01-01T00:00:00.000000000 0.00000000' in text
    assert 'ANGLE_2 = 2026-01-01T00:00:01.000000000 -45.25000000' in text
    segment, = Tdm.from_str(text).segments
    assert segment.metadata.angle_type == 'RADEC' and segment.metadata.path == '2,1'
    assert segment.metadata.reference_frame == 'ICRF'
    assert len(segment.data.observations) == 5


@pytest.mark.slow
def test_objects_of_a_flight_are_found_and_written(reprocess, tmp_path):
    flight = FlightOptions(days=0.0015, bag_hours=1.0, heads=1, magnitude_limit=5.5, fov_deg=15.0,
                           objects_hour=150.0, object_snr=20.0)
    (tmp_path / 'flight').mkdir()
    write_bag(tmp_path / 'flight', flight, 3, 0)
    objects = []
    for segment_s in (200.0, 65.0, 34.0):
        reprocess([tmp_path / 'flight'], tmp_path / 'run', segment_s=segment_s,
                  bag_topics=frozenset())
        objects.append([one.rows for one in _read(open_run(tmp_path / 'run'), 'head_1')])
        for name in ('tables', '.segments'):
            if segment_s > 34.0:
                shutil.rmtree(tmp_path / 'run' / name)
    # Of one segment, of two and of four: the same objects, each seen in the same frames.
    for others in objects[1:]:
        assert len(others) == len(objects[0])
        for rows, expected in zip(others, objects[0]):
            for name in ('stamp_ns', 'u', 'v'):
                np.testing.assert_array_equal(rows[name], expected[name])
            np.testing.assert_allclose(rows['ra_deg'], expected['ra_deg'], atol=3e-4)
    result = tracklets(tmp_path / 'run', tmp_path / 'out', 'TEST')
    assert len(result.records) >= 3
    for row in result.records:
        assert row['tracker'] == 'head_1' and 0.001 < row['rate_deg_s'] < 0.6
        assert row['detections'] >= 5 and row['located_with'] == ''
    text = (tmp_path / 'out' / 'head_1.tdm').read_text()
    assert text.count('META_START') == len(result.records)
    assert text.count('ANGLE_1') == sum(row['detections'] for row in result.records)
