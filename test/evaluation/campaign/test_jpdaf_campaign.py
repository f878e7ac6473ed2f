# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small runs of the campaign: its truth, its bound, its rule of process noise, its table."""

from dataclasses import asdict
import json
from pathlib import Path

from commands import invoke
import cv2
from native_bank import coordinated_turn
import numpy as np
import pytest
from startracker_evaluation.campaign import jpdaf as campaign, jpdaf_methods, jpdaf_runs
from startracker_evaluation.campaign.jpdaf_methods import (
    AS_PUBLISHED, METHODS, tracker_options, VARIANTS, velocity_changes)
from startracker_evaluation.campaign.jpdaf_runs import (
    CAMERA, Cell, DT_S, FALSE_POINTS, FRAMES, make_run, ORBIT_RATE_RAD_S, PUBLISHED)
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.motion_models import constant_velocity
import yaml

STILL, SHAKEN, TURNING = (Cell('linear', 0.0, 0.01), Cell('linear', 0.5, 0.01),
                          Cell('turning', 0.0, 0.02))


@pytest.fixture(scope='module')
def found():
    return {cell: campaign.errors(cell, False, 2, 5) for cell in (STILL, SHAKEN)}


def transition(motion):
    """Return the transition (4, 4) of the model of a motion at the rate of the orbit."""
    if motion == 'linear':
        return constant_velocity(DT_S, (1.0, 1.0))[0]
    return coordinated_turn(DT_S, -ORBIT_RATE_RAD_S, (1.0, 1.0))[0]


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


def test_the_method_of_the_paper_is_that_of_its_parameter_file():
    file = Path(__file__).parents[3] / 'config' / 'paper_jpdaf.yaml'
    given = yaml.safe_load(file.read_text())['/**/star_tracker']['ros__parameters']
    options = asdict(tracker_options(SHAKEN, AS_PUBLISHED))
    assert {name: options[name] for name in given} == given


def test_sna_is_that_of_the_paper_and_jpdaf_beats_its_ratio(found):
    for cell, one in found.items():
        sna, triad, optimal, coupled, published, beyond = one.boresight.mean(axis=(0, 2))
        assert 0.7 < sna / PUBLISHED[cell][0] < 1.3
        most = PUBLISHED[cell][1] / PUBLISHED[cell][0]
        assert optimal < triad and coupled < min(optimal, 0.4 * sna)
        assert max(published, beyond) < most * sna
        whole = one.whole.mean(axis=(0, 2))
        assert max(whole[-2:]) < most * whole[0]
        place = one.place.mean(axis=0)
        # Both axes of a measured position.
        assert 0.9 < place[0] / (2 * cell.variance_px2) < 1.1
        assert max(place[-2:]) < 0.3 * place[0]
        assert (one.fixed > 0.98).all()


def test_the_rows_compare_with_the_paper_and_name_what_is_missed(found):
    rows = list(campaign.cell_rows(SHAKEN, found[SHAKEN]))
    assert [row.case for row in rows] == [f'{SHAKEN}: SNA'] + [
        f'{SHAKEN}: {method}, jitter unknown' for method in METHODS]
    # Of an unknown jitter no bound of the paper holds or fails: the row says what was met.
    assert rows[1].holds is None and 'of measured jitter: boresight' in rows[1].bound
    compared = list(campaign.comparison_rows(SHAKEN, found[SHAKEN]))
    assert [row.case.split(': ')[1] for row in compared] == [
        'boresight, over SNA', 'whole angle, over SNA', 'mean square position error']
    for row in compared[:2]:
        assert row.paper == pytest.approx(2.8979 / 4.6878)
        assert max(row.as_published, row.beyond) < row.paper


def test_a_bound_within_the_interval_of_a_figure_is_not_judged():
    rng = np.random.default_rng(1)
    below = np.full(50, 2.0)
    ratio, margin = campaign.ratio_of_means(rng.normal(1.0, 0.2, 50), below)
    assert abs(ratio - 0.5) < 0.05 and margin == pytest.approx(0.1 * 2.01 / 50 ** 0.5, rel=0.3)
    assert campaign.at_most(ratio, margin, 0.6) is True
    assert campaign.at_most(ratio, margin, 0.4) is False
    assert campaign.at_most(ratio, margin, ratio + margin / 2) is None
    assert np.isinf(campaign.ratio_of_means(below[:1], below[:1])[1])
    row = campaign.MethodRow.judged('', '<= 1', [True, None])
    assert row.holds is None and 'too few trials' in row.bound
    assert campaign.MethodRow.judged('', '<= 1', [None, False]).holds is False


def test_no_method_is_better_than_the_bound_and_the_best_filter_comes_near(found):
    sna, triad, optimal, coupled, _, _ = (
        found[STILL].over_bound(k)[0] for k in range(len(campaign.ALL_METHODS)))
    assert coupled < optimal < triad < sna
    # Two runs, each of few independent errors.
    assert 0.6 < coupled < 1.5 and optimal < 2
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
        ahead = state[:-1] @ transition(cell.motion).T
        np.testing.assert_allclose(ahead[..., ::2], state[1:, :, ::2], rtol=0, atol=tolerance_px)


@pytest.mark.parametrize('motion', ['turning', 'linear'])
def test_process_noise_is_as_large_as_the_changes_of_velocity(motion):
    cell = Cell(motion, 0.5, 0.01)
    steady, roll = velocity_changes(cell)
    whitened = []
    for seed in range(8):
        state = states(make_run(cell, np.random.default_rng(seed)))
        change = (state[1:] - state[:-1] @ transition(motion).T)[..., 1::2]
        x, y = np.moveaxis(state[:-1, :, ::2] - [CAMERA.cx, CAMERA.cy], -1, 0)
        # A roll moves the star at (x, y) from the centre along (-y, x).
        along = np.stack([-y, x], -1)
        covariance = steady ** 2 * np.eye(2) + roll ** 2 * along[..., None] * along[..., None, :]
        whitened.append(np.einsum('fni,fnij,fnj->fn', change, np.linalg.inv(covariance), change))
    # One degree of freedom is that of the jumps. The other one, across, is of what adds up over
    # a block: far less in one frame than the random walk that comes as far.
    assert 0.8 < np.mean(whitened) < 1.25
    assert tracker_options(cell, {}).acceleration_deg_s2 == pytest.approx(
        np.degrees(steady / DT_S / CAMERA.fx))


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


def test_the_gyro_measures_the_rate_between_the_frames():
    run = make_run(SHAKEN, np.random.default_rng(8))
    off = run.gyro_rad_s - run.rate_rad_s[:-1]
    # 0.15 deg/sqrt(h) in 0.1 s, and the drift.
    assert np.degrees(off.std()) == pytest.approx(0.15 / 60 / DT_S ** 0.5, rel=0.1)
    assert (np.degrees(np.abs(off.mean(axis=0))) < 0.002).all()


def test_a_seed_repeats(found, monkeypatch):
    """By SNA and one of the filters: the runs are those of all."""
    (name, options), *_ = campaign.methods_of(STILL, False).items()
    monkeypatch.setattr(campaign, 'methods_of', lambda *_: {name: options})
    again = campaign.errors(STILL, False, 1, 5)
    np.testing.assert_array_equal(again.error[0], found[STILL].error[0, :2])
    assert not np.array_equal(campaign.errors(STILL, False, 1, 6).error, again.error)


def test_the_command_prints_every_cell_and_draws(tmp_path, monkeypatch, one_process):
    still = Cell('linear', 0.0, 0.02)
    cells = {cell: PUBLISHED[cell] for cell in (still, Cell('linear', 0.1, 0.02))}
    for module in (campaign, jpdaf_methods, jpdaf_runs):
        monkeypatch.setattr(module, 'FRAMES', 100)
    monkeypatch.setattr(campaign, 'PUBLISHED', cells)
    monkeypatch.setattr(campaign, 'VARIANT_CELLS', (Cell('linear', 0.1, 0.02),))
    done = invoke('campaign', 'jpdaf', '--trials', '1', '--json', '--output',
                  str(tmp_path / 'out'))
    # One run is too few for any bound.
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    rows = {row['case']: row for row in document['rows']}
    for cell, (sna, jpdaf) in cells.items():
        assert rows[f'{cell}: SNA']['paper'] == sna
        assert rows[f'{cell}: whole angle, over SNA']['paper'] == pytest.approx(jpdaf / sna)
    assert rows[f'{still}: JPDAF, TRIAD']['paper'] == cells[still][1]
    assert len(rows) == len(document['rows']) == 2 * (3 + 4) + 7 + len(VARIANTS)
    assert all(row['holds'] is None for row in document['rows'])
    assert all('too few trials' in row['bound'] for row in document['rows'] if row['bound'])
    assert document['conditions']['trials'] == 1
    for name in ('jpdaf', 'jpdaf_tracks', 'jpdaf_run'):
        assert cv2.imread(str(tmp_path / 'out' / f'{name}.png')).size
