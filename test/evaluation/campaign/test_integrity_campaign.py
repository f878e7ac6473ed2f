# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A few runs in which a careless tracker would publish a wrong attitude."""

from dataclasses import replace
import json

from commands import invoke
import numpy as np
import pytest
from scipy.stats import binom
from skies import SMALL_CAMERA
from startracker_evaluation.campaign import integrity
from startracker_evaluation.campaign.integrity import (
    CONDITIONS, IMAGE_CONDITIONS, integrity_runs, LIST_RUNS, MOTION_RUNS)
from startracker_evaluation.campaign.integrity_motion import motion_runs
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.tools.datasheet.image_runs import image_run
from startracker_ros.tools.datasheet.tally import Tally, tally_of, tally_of_rate
from startracker_ros.tools.figures.rows import share_below
from startracker_ros.tools.parallel import split_trials

MISLEADING = ['slews, gyro in deg/s', 'turned away at once', 'planet passing',
              'half of the image covered', 'dark for 2 s at 0.3 deg/s, gyro']


@pytest.mark.parametrize('name', MISLEADING)
def test_nothing_wrong_is_published(name):
    tally = integrity_runs(name, 1, seed=3)
    assert tally.frames == LIST_RUNS * CONDITIONS[name].frames
    assert tally.wrong == 0 and tally.worst < 1
    assert 100 * tally.published >= CONDITIONS[name].needed_percent * tally.frames


# A second of a processor for each frame; test/core/identify has single fields of wrong cameras.
@pytest.mark.long
@pytest.mark.parametrize('name', ['mirrored image', 'focal length off by 1 %'])
def test_nothing_at_all_is_published_of_a_wrong_camera(name, monkeypatch):
    monkeypatch.setitem(CONDITIONS, name, replace(CONDITIONS[name], frames=120))
    assert integrity_runs(name, 1, seed=4).published == 0


def small_run(name, **changes):
    return image_run(replace(IMAGE_CONDITIONS[name], **{'frames': 25, **changes}), 5, SMALL_CAMERA)


@pytest.mark.parametrize('name', ['smear 2 deg/s', 'smear 5 deg/s, gyro', '300 hits',
                                  '5 saturated columns and rows'])
def test_images_with_artefacts_give_right_attitudes(name):
    condition, tally = IMAGE_CONDITIONS[name], small_run(name)
    assert tally.frames == 25 and tally.due == 25 - (condition.clean_frames or 2)
    assert tally.wrong == 0 and 0 < tally.worst < 1
    assert 100 * tally.available >= condition.needed_percent * tally.due


def test_faint_streaks_of_a_short_exposure_are_tracked():
    tally = image_run(replace(IMAGE_CONDITIONS['smear 5 deg/s, 20 ms'], frames=16), 174219522660)
    assert tally.wrong == 0 and tally.available >= 0.9 * tally.due


def test_of_a_shaken_camera_only_the_upper_bound_of_nees_is_asked(one_process, monkeypatch):
    for name in 'start with 100 spots', 'kicks of 40 arcsec':
        monkeypatch.setitem(IMAGE_CONDITIONS, name, replace(IMAGE_CONDITIONS[name], frames=4))
    done = invoke('campaign', 'integrity', '--trials', '1', '--json', '--only',
                  'start with 100 spots', '--only', 'kicks of 40 arcsec')
    assert ['NEES 1.5 .. 3.8' in row['bound'] for row in json.loads(done.stdout)['rows']] == [
        True, False]


def test_images_with_a_wrong_stamp_are_counted_as_wrong():
    tally = small_run('stamp at the end', frames=6)
    assert tally.available == tally.due == tally.wrong == tally.gross == 4
    # 0.5 deg/s for half an exposure of 0.1 s about the random axis of the run.
    axis = np.random.default_rng(5).standard_normal(3)
    error_arcsec = 0.5 * 3600 * 0.05 * np.hypot(*axis[:2]) / np.linalg.norm(axis)
    assert tally.square_arcsec2 / tally.published == pytest.approx(error_arcsec ** 2, rel=0.05)


def test_images_without_stars_are_due():
    dark = DetectorOptions(zero_flux_e_s=1.0)
    tally = small_run('clean images', frames=4, detector=dark)
    assert tally == Tally(frames=4, due=2)
    assert small_run('start with 100 spots', frames=4, detector=dark) == Tally(frames=4, due=1)


def test_the_command_runs_both_kinds(one_process):
    done = invoke('campaign', 'integrity', '--trials', '1', '--json', '--only', 'steady turn',
                  '--only', 'start with 100 spots')
    lists, images = json.loads(done.stdout)['rows']
    assert lists['condition'] == 'steady turn' and lists['frames'] == 2000
    assert lists['published_percent'] == pytest.approx(99.5)
    assert lists['rates_beyond_5_sigma'] == 0 and 0.2 < lists['rates_mean_nees'] < 3
    # 2000 frames show no share below 1e-4.
    assert lists['wrong'] == 0 and lists['wrong_below'] == pytest.approx(3 / 2000, rel=0.01)
    assert lists['holds'] is None and 1.5 <= lists['mean_nees'] <= 3.8
    assert '0 gross, NEES 1.5 .. 3.8' in lists['bound']
    assert images['frames'] == 10 and images['published_percent'] in (0, 100)
    assert images['holds'] is (None if images['published_percent'] == 100 else False)


def test_a_wrong_attitude_would_be_counted():
    truth = np.array([0.0, 0.0, 0.0, 1.0])
    covariance = np.eye(3) * 1e-12
    off = multiply(truth, quaternion_from_rotation_vector([0.0, 3.2e-4, 0.0]))
    assert tally_of(truth, covariance, truth) == Tally(published=1)
    wrong = tally_of(off, covariance, truth)
    assert wrong.wrong == wrong.gross == 1
    assert wrong.worst_sigma == pytest.approx(320)
    assert tally_of(off, covariance * 1e4, truth).wrong == 0


def test_an_error_of_6_sigma_and_few_arcseconds_is_wrong_but_not_gross():
    truth = np.array([0.0, 0.0, 0.0, 1.0])
    off = multiply(truth, quaternion_from_rotation_vector([6e-6, 0.0, 0.0]))
    tally = tally_of(off, np.eye(3) * 1e-12, truth)
    assert tally.wrong == 1 and tally.gross == 0
    assert tally.worst_sigma == pytest.approx(6) and tally.nees == pytest.approx(36)


@pytest.mark.parametrize('name', ['sway 0.2 deg, 2 s', 'ramps of 0.5 deg/s^2, 4 s'])
def test_a_rolling_shutter_on_a_body_that_changes_its_rate_gives_right_attitudes(name):
    """The rate before moved the stars to one time: a tenth of the frames were wrong."""
    tally = motion_runs(f'list, {name}, rolling shutter', 2, 5, frames=100)
    assert tally.available >= 0.98 * tally.due and tally.wrong == 0
    assert tally.nees < 4.5 * tally.published


@pytest.mark.parametrize('name', [
    'three images in a row one frame late, 0.2 deg/s',
    'three images in a row one frame late, 1 deg/s', 'line time +10 %, 1 deg/s'])
def test_images_of_another_time_and_wrong_line_times_are_refused_or_covered(name):
    """The second of the late frames, of an unchanged rate, was believed: an eighth was wrong."""
    tally = motion_runs(f'list, {name}', 2, 5, frames=80)
    assert tally.published and tally.wrong == 0


def test_at_other_times_is_within_its_covariance():
    tally = motion_runs('list, sway 0.05 deg, 1 s, exposed 0.1 s', 1, 5, frames=80)
    assert tally.at > 140 and tally.at_wrong <= 3


@pytest.mark.parametrize('wrong, of, most', [
    (0, 30_000, 1e-4), (0, 2200, 1.4e-3), (1, 2500, 2e-3)])
def test_the_share_that_is_wrong_is_below_the_limit_of_clopper_and_pearson(wrong, of, most):
    limit = share_below(wrong, of)
    assert limit < most
    # So few or fewer would occur in one case of twenty.
    assert binom.cdf(wrong, of, limit) == pytest.approx(0.05)


def test_a_rate_beyond_its_covariance_is_counted():
    tally = tally_of_rate(np.array([0.0, 7e-6, 0.0]), np.eye(3) * 1e-12, np.array([0, 1e-6, 0]))
    assert tally.rates_wrong == 1 and tally.rates_nees == pytest.approx(36)
    assert tally_of_rate(np.zeros(3), np.eye(3) * 1e-12, np.zeros(3)) == Tally()


def test_no_run_of_a_campaign_is_counted_twice(monkeypatch):
    seeds = []
    monkeypatch.setattr(integrity, 'motion_runs', lambda name, runs, seed: seeds.extend(
        range(seed, seed + runs)))
    for part in split_trials(22, 4, 7):
        integrity_runs('list, no sway', *part)
    assert len(seeds) == len(set(seeds)) == 22 * MOTION_RUNS


def test_tallies_add_up():
    both = (Tally(1, 1, 1, 1, 0, 1, 0, 2.0, 3.0, 7.0, 1, 2.5)
            + Tally(1, 1, 0, 1, 1, 0, 1, 4.0, 5.0, 9.0, 1, 1.5))
    assert both == Tally(2, 2, 1, 2, 1, 1, 1, 6.0, 8.0, 9.0, 2, 4.0)
