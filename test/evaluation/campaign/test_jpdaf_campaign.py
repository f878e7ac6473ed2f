"""Small runs of the campaign: its truth, its bound, its rule of process noise, its table."""

import json

from click.testing import CliRunner
import cv2
import numpy as np
import pytest
from startracker_ros.__main__ import main
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.motion_models import image_jacobian
from startracker_ros.evaluation.campaign import jpdaf as campaign
from startracker_ros.evaluation.campaign.jpdaf_methods import METHODS, star_model
from startracker_ros.evaluation.campaign.jpdaf_runs import (
    CAMERA, Cell, DT_S, FALSE_POINTS, FRAMES, make_run, PUBLISHED)

STILL, SHAKEN, TURNING = (Cell('linear', 0.0, 0.01), Cell('linear', 0.5, 0.01),
                          Cell('turning', 0.0, 0.02))


@pytest.fixture(scope='module')
def found():
    return {cell: campaign.errors(cell, 4, 5) for cell in (STILL, SHAKEN, TURNING)}


def states(run):
    """Return the true state of each star of a run, (F, 4, 4)."""
    state = np.empty((FRAMES, 4, 4))
    for k, (q, rate) in enumerate(zip(run.quaternion, run.rate_rad_s)):
        sensor = rotate(conjugate(q), run.icrf)
        state[k][:, ::2] = CAMERA.project(sensor)
        state[k][:, 1::2] = image_jacobian(CAMERA, sensor) @ rate
    return state


def test_the_paper_has_18_cells_whose_sna_is_one_angle_times_sigma():
    assert len(PUBLISHED) == 18
    per_px = [sna / cell.sigma_px for cell, (sna, _) in PUBLISHED.items()]
    assert min(per_px) > 46 and max(per_px) < 48


def test_sna_is_that_of_the_paper_and_jpdaf_beats_its_ratio(found):
    for cell, one in found.items():
        sna, triad, optimal, coupled = one.boresight.mean(axis=(0, 2))
        assert 0.7 < sna / PUBLISHED[cell][0] < 1.3
        assert optimal < triad < sna * PUBLISHED[cell][1] / PUBLISHED[cell][0]
        assert coupled < min(optimal, 0.4 * sna)
        rows = list(campaign.cell_rows(cell, one))
        assert [row.case for row in rows] == [
            f'{cell}: {method}' for method in METHODS]
        assert rows[1].ratio == triad / sna and all(row.holds for row in rows[1:])


def test_no_method_is_better_than_the_bound_and_the_best_filter_comes_near(found):
    sna, triad, optimal, coupled = (found[STILL].over_bound(method)
                                    for method in METHODS)
    assert coupled < optimal < triad < sna
    # Four runs, each of few independent errors.
    assert 0.7 < coupled < 1.4 and optimal < 2
    assert np.isnan(found[SHAKEN].bound).all()


def test_the_bound_is_that_of_all_frames_adjusted_together():
    run = make_run(STILL, np.random.default_rng(4))
    last = FRAMES // 8
    bound = campaign.cramer_rao_bound(run)[last]

    def positions(error):
        """Return the stars in px up to the last frame with an error of its attitude and rate."""
        q = multiply(run.quaternion[last], quaternion_from_rotation_vector(error[:3]))
        rate = run.rate_rad_s[last] + error[3:]
        back = [multiply(q, quaternion_from_rotation_vector(-rate * DT_S * (last - k)))
                for k in range(last + 1)]
        return np.concatenate([
            CAMERA.project(rotate(conjugate(q), run.icrf[seen >= 0])).ravel()
            for q, seen in zip(back, run.seen)])

    step = 1e-6
    design = np.stack([(positions(step * axis) - positions(-step * axis)) / (2 * step)
                       for axis in np.eye(6)], -1)
    covariance = np.linalg.inv(design.T @ design) * STILL.variance_px2
    np.testing.assert_allclose(bound, covariance[:3, :3], rtol=1e-3,
                               atol=1e-3 * np.trace(bound) / 3)


def test_a_coordinated_turn_is_the_turning_image_and_a_straight_line_nearly_the_linear_one():
    for cell, tolerance_px in ((TURNING, 1e-7), (STILL, 1e-4)):
        state = states(make_run(cell, np.random.default_rng(6)))
        transition, _ = star_model(cell)
        ahead = state[:-1] @ transition.T
        np.testing.assert_allclose(ahead[..., ::2], state[1:, :, ::2], rtol=0, atol=tolerance_px)


@pytest.mark.parametrize('motion', ['turning', 'linear'])
def test_process_noise_is_as_large_as_the_changes_of_velocity(motion):
    cell = Cell(motion, 0.5, 0.01)
    transition, noise = star_model(cell)
    whitened = []
    for seed in range(8):
        state = states(make_run(cell, np.random.default_rng(seed)))
        change = (state[1:] - state[:-1] @ transition.T)[..., 1::2]
        for row, each in zip(change, state[:-1]):
            covariance = noise(each[:, ::2])[:, 1::2, 1::2]
            whitened.append(np.einsum('ni,nij,nj->n', row, np.linalg.inv(covariance), row))
    # One degree of freedom is that of the jumps. The other one, across, is of what adds up over
    # a block: far less in one frame than the random walk that comes as far.
    assert 0.8 < np.mean(whitened) < 1.25


def test_false_points_and_missing_stars_are_as_many_as_configured():
    run = make_run(STILL, np.random.default_rng(7))
    assert (run.seen[0] >= 0).all()
    assert 0.97 < (run.seen >= 0).mean() < 1
    false = [len(uv) - (seen >= 0).sum() for uv, seen in zip(run.centroids, run.seen)]
    assert abs(np.mean(false) - FALSE_POINTS) < 3
    truth = states(run)[..., ::2]
    off = np.concatenate([uv[seen[seen >= 0]] - true_uv[seen >= 0] for uv, seen, true_uv in zip(
        run.centroids, run.seen, truth)])
    assert abs(off.std() / STILL.sigma_px - 1) < 0.05


@pytest.mark.parametrize('cell', campaign.MODELS, ids=str)
def test_the_covariance_of_a_star_is_true_where_the_model_is(cell):
    squares = campaign.normalised_errors(cell, 30, 3)
    # 30 runs, 4 stars, 4 degrees of freedom: 1 +- 0.065 (1 sigma).
    assert 0.75 < squares.mean() / 4 < 1.25
    assert campaign.consistency_row('', squares, 4).bound == '0.877 .. 1.130'
    assert not campaign.consistency_row('', 2 * squares, 4).holds


def test_a_seed_repeats(found):
    again = campaign.errors(STILL, 1, 5)
    np.testing.assert_array_equal(again.error[0], found[STILL].error[0])
    assert not np.array_equal(campaign.errors(STILL, 1, 6).error, again.error)


def test_the_command_prints_every_cell_and_draws(tmp_path, monkeypatch, one_process):
    cells = {cell: PUBLISHED[cell] for cell in (STILL, TURNING, Cell('linear', 0.1, 0.02))}
    monkeypatch.setattr(campaign, 'PUBLISHED', cells)
    monkeypatch.setattr(campaign, '_MODEL_RUNS', 10)
    done = CliRunner().invoke(main, ['campaign', 'jpdaf', '--trials', '1', '--json',
                                     '--output', str(tmp_path / 'out')])
    # One run says little about how well the bounds are held.
    assert done.exit_code in (0, 1), done.output
    document = json.loads(done.stdout)
    rows = {row['case']: row for row in document['rows']}
    for cell, (sna, jpdaf) in cells.items():
        assert rows[f'{cell}: SNA']['paper'] == sna
        assert rows[f'{cell}: JPDAF, TRIAD']['paper'] == jpdaf
    assert len(rows) == 3 * 4 + 2 * 5 + 2
    assert document['conditions']['trials'] == 1
    assert cv2.imread(str(tmp_path / 'out' / 'jpdaf.png')).size
