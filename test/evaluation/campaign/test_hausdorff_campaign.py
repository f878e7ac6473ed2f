# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The Hausdorff campaign: its rows hold, stand compared with the paper's, and can be repeated."""

from itertools import combinations

import cv2
import numpy as np
import pytest
from startracker_evaluation.campaign import hausdorff
from startracker_evaluation.campaign.hausdorff import (
    CELLS, directions, FiveStarStructures, FRAMES, PUBLISHED, run_hausdorff_campaign, stored_sets)

CELLS_TO_RUN = (('pivot', 5.5), ('segment', 6.0))


@pytest.fixture(scope='module')
def result(one_process, tmp_path_factory):
    output = tmp_path_factory.mktemp('hausdorff')
    with pytest.MonkeyPatch.context() as patch:
        # A twentieth of the sets of five stars that there are to V 4.
        patch.setattr(hausdorff, 'SLOW_CELL', 3.5)
        result = run_hausdorff_campaign(trials=10, seed=1, cells=CELLS_TO_RUN, output=output)
    picture = cv2.imread(str(output / 'figures_10_11_12_times.png'))
    assert picture.shape[0] > 200 and picture.std() > 10
    return result


@pytest.fixture(scope='module')
def rows(result):
    return {row.case: row for row in result.rows}


def test_every_condition_stands_beside_the_paper(result, rows):
    assert len(CELLS) == 8 and result.conditions['trials'] == 10
    for case in ('pivot, V 5.5', 'segment, V 6'):
        for name in FRAMES:
            shares = [rows[f'{case}: {share}, {name}'] for share in ('none', 'correct', 'wrong')]
            for column in ('as_published', 'beyond'):
                assert sum(getattr(row, column) for row in shares) == pytest.approx(100)
    assert rows['segment, V 6: none, no noise, at pivots'].paper.startswith('0.15, misprint')
    assert rows['segment, V 6: sets'].paper == 65154
    assert rows['segment, V 6: time'].paper == 36.4


def test_ten_directions_are_too_few_for_the_bounds(rows):
    row = rows['pivot, V 5.5: correct, no noise, at pivots']
    assert row.holds is None and row.bound.endswith('too few trials, 10 of 200')
    assert rows['pivot, V 5.5: sets'].holds


def test_one_distance_does_not_identify_stars_in_noise_and_the_field_does(rows):
    for case in ('pivot, V 5.5', 'segment, V 6'):
        correct = rows[f'{case}: correct, 0.1 px, at pivots']
        assert correct.as_published < 50 and correct.beyond >= 85
        assert all(rows[f'{case}: wrong, {name}'].beyond == 0 for name in FRAMES)


def test_five_star_structures_are_all_sets_that_an_image_can_hold():
    rng = np.random.default_rng(3)
    direction = rng.normal(0, 0.3, (12, 3)) + [0, 0, 1]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    structures = FiveStarStructures(direction, 0.6)
    near = np.arccos(np.clip(direction @ direction.T, -1, 1)) <= 0.6
    expected = [five for five in combinations(range(12), 5)
                if all(near[pair] for pair in combinations(five, 2))]
    assert sorted(map(tuple, structures.star.tolist())) == sorted(expected) and expected
    chosen = structures.star[0].astype(int)
    np.testing.assert_array_equal(structures.identify(direction[chosen], 1e-5), chosen)
    assert structures.identify(direction[chosen[:4]], 1e-5) is None
    assert structures.identify(direction[chosen], 10.0) is None or len(expected) == 1


@pytest.mark.parametrize('method, magnitude_limit', [
    ('pivot', 5.0), ('pivot', 5.5), ('segment', 5.0), ('segment', 6.5)])
def test_the_sets_are_as_many_as_published(method, magnitude_limit):
    published = PUBLISHED[method, magnitude_limit].sets
    assert stored_sets(method, magnitude_limit) == pytest.approx(published, rel=0.01)


def test_directions_can_be_repeated():
    def figures(seed):
        found = directions('pivot', 5.5, '0.1 px, anywhere', 10, seed)
        return found.stars.tolist(), found.solved.tolist(), found.correct.tolist()

    assert figures(7) == figures(7) != figures(8)
