# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small runs of the campaign: what it counts, that it repeats, what it prints and draws."""

import json

from commands import invoke
import cv2
import numpy as np
import pytest
from startracker_evaluation.campaign import extended_grid as campaign
from startracker_evaluation.campaign.extended_grid_frames import (
    camera, frames, gyro_drift_px, predicted, triangle_votes)
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.core.papers.extended_grid import PredictedField
from startracker_ros.tools.figures.rows import mean_chi_square_bounds


@pytest.fixture(scope='module')
def base():
    return frames(campaign.BASE, 100, 5)


def test_the_scale_is_that_of_the_paper():
    """1024 px span the extended field of 8 deg; 1 deg/h and its noise move a star by 0.54 px."""
    assert camera(4.0).pixel_rad / ARCSEC == pytest.approx(8 * 3600 / 1024, rel=0.002)
    drift_px = gyro_drift_px(campaign.PERIODS[-1], 500, np.random.default_rng(0))
    assert drift_px.mean() == pytest.approx(0.54, rel=0.1)


def test_most_frames_are_solved_and_none_wrongly(base):
    assert base.percent('verified') >= 95 and not base.wrong[:, 0].any()
    assert base.two_percent('grid') >= base.percent('grid') >= 95
    assert not (base.solved('verified') & (base.stars < 2)).any()
    assert base.extended_right.sum() > base.plain_right.sum() > 0
    assert (base.extended_right <= base.neighbours).all()
    assert (base.pairs.sum(1) <= base.stars * (base.stars - 1) // 2).all() and base.pairs.any()


def test_three_limits_recognise_what_one_misses(base):
    """A star next to the limit may be in the image and not in its catalogue, or the reverse."""
    assert base.right.sum(0)[1] > base.right.sum(0)[2]
    assert base.percent('grid') > base.percent('plain grid')


def test_a_seed_repeats_and_has_the_same_directions_under_every_condition(base):
    again = frames(campaign.BASE, 20, 5)
    np.testing.assert_array_equal(again.stars, base.stars[:20])
    np.testing.assert_array_equal(again.extended_right, base.extended_right[:20])
    noisy = frames(campaign.POSITIONS[-1], 20, 5)
    assert np.corrcoef(noisy.stars, again.stars)[0, 1] > 0.9


def test_without_noise_every_frame_of_two_stars_is_solved():
    tally = frames(campaign.PERFECT, 60, 5)
    for method in ('verified', 'grid', 'triangles'):
        assert tally.solved(method)[tally.stars >= 2].all()


def test_a_drifting_gyro_is_predicted_within_its_covariance():
    rng = np.random.default_rng(1)
    condition = campaign.PERIODS[-1]
    normalised = []
    for _ in range(300):
        truth, prior = predicted(np.array([0.5, -0.5, 0.1, 0.7]), condition, rng)
        error = attitude_error(prior.quaternion, truth)
        normalised.append(error @ np.linalg.solve(prior.covariance_sensor, error))
    low, high = mean_chi_square_bounds(3, len(normalised))
    assert low < np.mean(normalised) < high, (low, np.mean(normalised), high)


def field_of(place, inside):
    count = len(place)
    return PredictedField(np.arange(count), place, np.arange(count) / 10, inside, inside)


def test_triangles_need_two_neighbours_and_one_match():
    rng = np.random.default_rng(2)
    place = rng.uniform(-0.05, 0.05, (30, 2))
    inside = (np.abs(place) < 0.03).all(1)
    image = field_of(place, inside)
    votes = triangle_votes(place[inside], image, 0.005, 1e-6)
    np.testing.assert_array_equal(votes, np.flatnonzero(inside))
    shaken = place[inside] + rng.normal(0, 1e-4, (inside.sum(), 2))
    assert (triangle_votes(shaken, image, 0.005, 1e-6) == -1).all()
    pair = field_of(place[:2], np.ones(2, bool))
    assert (triangle_votes(place[:2], pair, 0.005, 1e-6) == -1).all()


def test_the_fourth_step_identifies_observed_stars_by_those_beyond_the_edge():
    """Two equal triangles inside tell nothing; that of the star beyond the edge is its own."""
    triangle = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.012]])
    place = np.concatenate([triangle, triangle + [0.1, 0.0], [[0.0, 0.05]]])
    inside = np.arange(7) < 6
    votes = triangle_votes(place[:6], field_of(place, inside), 0.001, 1e-6)
    np.testing.assert_array_equal(votes, [0, -1, 2, -1, -1, -1])


def test_the_command_prints_the_rows_and_draws_the_figures(tmp_path, one_process):
    done = invoke('campaign', 'extended-grid', '--trials', '4', '--json', '--output',
                  str(tmp_path))
    document = json.loads(done.stdout)
    assert document['name'] == 'campaign extended-grid'
    assert document['conditions']['trials'] == 4
    rows = {row['case']: row for row in document['rows']}
    assert all({'ours', 'paper', 'as_published', 'beyond', 'unit', 'bound', 'holds'} <= set(row)
               for row in rows.values())
    row = rows['success, 1 px, 0.2 mag, 1 s']
    assert row['paper'] == '> 97.4' and row['holds'] is None
    assert row['bound'] == ('as published >= 97.4; beyond >= 97.4: '
                            'too few trials, 4 of 385')
    assert rows['nearest neighbour right, extended image']['paper'] == '86.7'
    assert next(row for case, row in rows.items() if 'false star' in case)['beyond'] == 0
    assert done.exit_code == 0
    pictures = sorted(path.name for path in tmp_path.iterdir())
    assert [name.split('_')[1] for name in pictures] == ['09', '14', '17', '10', '12', '15']
    for name in pictures:
        picture = cv2.imread(str(tmp_path / name))
        assert picture.shape[0] > 200 and picture.std() > 10
