"""Small runs of the campaign: what it counts, that it repeats, what it prints and draws."""

import json

from click.testing import CliRunner
import cv2
import numpy as np
import pytest
from startracker_ros.__main__ import main
from startracker_ros.core.identify.extended_grid import PredictedField
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.evaluation.campaign import extended_grid as campaign
from startracker_ros.evaluation.campaign.extended_grid_frames import (
    frames, predicted, triangle_votes)
from startracker_ros.tools.figures.rows import mean_chi_square_bounds


@pytest.fixture(scope='module')
def base():
    return frames(campaign.BASE, 100, 5)


def test_most_frames_are_solved_and_none_wrongly(base):
    assert base.solved.mean() >= 0.95 and not base.wrong.any()
    assert not (base.solved & (base.stars < 2)).any()
    assert base.extended_right.sum() > base.plain_right.sum() > 0
    assert (base.extended_right <= base.neighbours).all()


def test_a_seed_repeats_and_has_the_same_directions_under_every_condition(base):
    again = frames(campaign.BASE, 20, 5)
    np.testing.assert_array_equal(again.stars, base.stars[:20])
    np.testing.assert_array_equal(again.extended_right, base.extended_right[:20])
    noisy = frames(campaign.POSITIONS[-1], 20, 5)
    assert np.corrcoef(noisy.stars, again.stars)[0, 1] > 0.9


def test_without_noise_every_frame_of_two_stars_is_solved():
    tally = frames(campaign.PERFECT, 60, 5)
    assert tally.solved[tally.stars >= 2].all()


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


def test_triangles_need_two_neighbours_and_one_match():
    rng = np.random.default_rng(2)
    place = rng.uniform(-0.05, 0.05, (30, 2))
    inside = (np.abs(place) < 0.03).all(1)
    image = PredictedField(np.arange(30), place, inside, inside)
    votes = triangle_votes(place[inside], image, 0.005, 1e-6)
    np.testing.assert_array_equal(votes, np.flatnonzero(inside))
    shaken = place[inside] + rng.normal(0, 1e-4, (inside.sum(), 2))
    assert (triangle_votes(shaken, image, 0.005, 1e-6) == -1).all()
    pair = PredictedField(np.arange(2), place[:2], *np.ones((2, 2), bool))
    assert (triangle_votes(place[:2], pair, 0.005, 1e-6) == -1).all()


def test_the_command_prints_the_rows_and_draws_the_curves(tmp_path, one_process):
    done = CliRunner().invoke(main, ['campaign', 'extended-grid', '--trials', '6', '--json',
                                     '--output', str(tmp_path)])
    document = json.loads(done.stdout.splitlines()[-1])
    assert document['name'] == 'campaign extended-grid' and document['conditions']['trials'] == 6
    rows = {row['case']: row for row in document['rows']}
    assert all({'ours', 'paper', 'unit', 'bound', 'holds'} <= set(row) for row in rows.values())
    assert rows['success, position noise 1 px']['paper'] == '> 97.4'
    assert rows['nearest neighbour right, extended image']['paper'] == '86.7'
    assert next(row for case, row in rows.items() if 'wrong star' in case)['ours'] == 0
    assert done.exit_code == (0 if all(row['holds'] for row in rows.values()) else 1)
    picture = cv2.imread(str(tmp_path / 'extended_grid.png'))
    assert picture.shape[0] > 300 and picture.std() > 10
