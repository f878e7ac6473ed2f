# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tracklets of one object become one, those of different objects do not."""

import numpy as np
import pytest
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE
from startracker_ros.tools.reprocess.tracklets import continued, joined, split_tracklets

STAMP_NS = 1_767_225_600_000_000_000
SIGMA_ARCSEC = 8.0


def passing(number, seconds, *, rate_deg_s=0.2, offset_deg=0.0, closest_s=20.0, dec_deg=0.0,
            seed=0):
    """Return the detections of an object that passes at a constant velocity, at most so fast."""
    rng = np.random.default_rng(seed + number)
    path = np.radians(rate_deg_s) * (np.array(seconds, float) - closest_s)
    line = np.stack([np.ones(len(path)), path, np.full(len(path), np.radians(offset_deg))], -1)
    turn = np.radians(dec_deg)
    line = line @ np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0],
                            [-np.sin(turn), 0, np.cos(turn)]])
    ra, dec = np.degrees(radec_from_unit(line / np.linalg.norm(line, axis=1)[:, None]))
    rows = np.zeros(len(path), TRACKLET_DTYPE)
    rows['stamp_ns'] = STAMP_NS + np.array(seconds) * 1_000_000_000
    rows['tracklet'] = number
    noise = rng.normal(0, SIGMA_ARCSEC / 3600, (2, len(path)))
    rows['ra_deg'] = (ra + noise[0] / np.cos(np.radians(dec))) % 360
    rows['dec_deg'] = dec + noise[1]
    rows['cov_ee_arcsec2'] = rows['cov_nn_arcsec2'] = SIGMA_ARCSEC ** 2
    rows['u'], rows['v'] = np.array(seconds), number
    return rows


def numbers(*parts):
    """Return the numbers of the tracklets of all detections, once each."""
    return np.unique(continued(joined(np.concatenate(parts)))['tracklet']).tolist()


@pytest.mark.parametrize('dec_deg', [0.0, 86.0])
@pytest.mark.parametrize('rate_deg_s', [0.01, 0.2, 0.7])
def test_an_object_that_was_lost_for_a_while_is_one(rate_deg_s, dec_deg):
    found = [numbers(passing(1, range(12), rate_deg_s=rate_deg_s, dec_deg=dec_deg,
                             seed=seed),
                     passing(2, range(18, 32), rate_deg_s=rate_deg_s, dec_deg=dec_deg,
                             seed=seed),
                     passing(3, range(35, 41), rate_deg_s=rate_deg_s, dec_deg=dec_deg,
                             seed=seed))
             for seed in range(0, 200, 10)]
    assert found == [[1]] * 20


def test_another_object_is_not_taken_for_it():
    first = passing(1, range(12))
    assert numbers(first, passing(2, range(18, 32), offset_deg=0.1)) == [1, 2]
    assert numbers(first, passing(2, range(18, 32), rate_deg_s=0.25)) == [1, 2]
    # At the same place at the same time both are objects.
    assert numbers(first, passing(2, range(6, 20), offset_deg=0.1)) == [1, 2]


def test_a_gap_that_is_longer_than_what_was_seen_is_not_bridged():
    assert numbers(passing(1, range(12)), passing(2, range(26, 36))) == [1, 2]
    assert numbers(passing(1, range(12)), passing(2, range(20, 31))) == [1]


def test_of_two_that_come_into_question_none_is_taken():
    assert numbers(passing(1, range(12)), passing(2, range(15, 27)),
                   passing(3, range(15, 27), seed=5)) == [1, 2, 3]


def test_chains_of_segments_and_gaps_end_in_one_number():
    rows = np.concatenate([passing(number, seconds) for number, seconds in (
        (7, range(10)), (9, range(14, 24)), (8, range(28, 38)))])
    overlap = rows[rows['tracklet'] == 8].copy()
    overlap['tracklet'] = 5
    rows = continued(joined(np.append(rows, overlap)))
    part, = split_tracklets(rows)
    assert len(part) == 30 and set(part['tracklet']) == {5}
    assert (np.diff(part['stamp_ns']) > 0).all()


def test_no_rows_have_no_tracklets():
    assert len(continued(joined(np.empty(0, TRACKLET_DTYPE)))) == 0
    assert split_tracklets(np.empty(0, TRACKLET_DTYPE)) == []
