# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mounts: learnt in flight, their steps, and the file."""

import numpy as np
import pytest
from startracker_evaluation.campaign.heads_scene import NAMES, Scene, SceneRun
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.head import HeadFrame
from startracker_ros.core.fusion.mounts import (
    basis, load_mounts, Mount, MountError, MountOptions, save_mounts)
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.fusion.steps import BLOCK_S, StepDetector
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, conjugate, multiply

MOUNT = np.array([0.5, 0.5, 0.5, 0.5])
VARIANCE, NO_LAW = (ARCSEC * np.array([1, 1, 11])) ** 2, np.empty(0)


def learn(scene, options, seed=6):
    run = SceneRun(scene, np.random.default_rng(seed))
    fusion = AttitudeFusion(run.mount_file(), FusionOptions(), options)
    return fusion, list(run.events(fusion))


def test_an_orbit_of_bending_is_learnt_and_lasts_in_the_file(tmp_path):
    period_s = 100.0
    scene = Scene(2 * period_s, period_s=1.0, orbit_s=period_s, bend_arcsec=20.0)
    options = MountOptions(mount_sigma_arcsec=3.0, mount_orbit_arcsec=20.0,
                           orbit_period_s=period_s, mount_walk_arcsec_sqrt_h=0.1)
    fusion, outcomes = learn(scene, options)
    stamp_ns, truth = outcomes[-1].fused.stamp_ns, outcomes[-1].misalignment
    save_mounts(fusion.mounts.learnt(), tmp_path / 'mounts.yaml')
    reloaded = AttitudeFusion(load_mounts(tmp_path / 'mounts.yaml', NAMES), FusionOptions(),
                              options)
    for head, name in enumerate(NAMES):
        found, covariance = fusion.mounts.misalignment(name, stamp_ns)
        error = found - truth[head]
        if head:
            assert 0.05 * ARCSEC < np.sqrt(np.diag(covariance)).max() < 4 * ARCSEC
            assert error @ np.linalg.solve(covariance, error) < 20
            assert np.linalg.norm(truth[head]) > 3 * np.linalg.norm(error)
        q, again = reloaded.mounts.at(name, stamp_ns)
        now, before = fusion.mounts.at(name, stamp_ns)
        assert np.linalg.norm(attitude_error(q, now)) < 1e-9
        np.testing.assert_allclose(again, before, rtol=1e-9, atol=1e-20)


def test_bending_with_the_temperature_is_learnt():
    scene = Scene(300.0, period_s=1.0, temperature_arcsec_k=1.0)
    fusion, outcomes = learn(scene, MountOptions(
        mount_sigma_arcsec=3.0, mount_temperature_arcsec_k=1.0, mount_walk_arcsec_sqrt_h=0.1))
    stamp_ns, truth = outcomes[-1].fused.stamp_ns, outcomes[-1].misalignment
    for head in (1, 2):
        error = fusion.mounts.misalignment(NAMES[head], stamp_ns)[0] - truth[head]
        assert np.linalg.norm(error) < 0.3 * np.linalg.norm(truth[head])


def test_a_mount_is_frozen_when_its_head_is_alone():
    fusion, _ = learn(Scene(20.0), MountOptions(mount_sigma_arcsec=3.0))
    before = fusion.mounts.misalignment('head_2', 0)
    run = SceneRun(Scene(1.0, heads=2), np.random.default_rng(7))
    # Frames of one head tell nothing of the difference of two.
    state = fusion._history[-1].state
    other = fusion.heads['head_2']
    q = multiply(state.quaternion, run.mounts[1])
    for index in range(1, 50):
        fusion.add_frame('head_2', HeadFrame(
            state.stamp_ns + index * 200_000_000, q, np.eye(3) * (5 * ARCSEC) ** 2))
    after = fusion.mounts.misalignment('head_2', 0)
    assert other.counts['used'] > 80
    # The covariance does not shrink, but grows with the random walk.
    assert np.trace(after[1]) > 0.8 * np.trace(before[1])


def test_a_step_is_found_and_dated():
    detector, rng, found = StepDetector(('a', 'b')), np.random.default_rng(8), []
    size = np.array([3.0, -4.0, 0.0]) * ARCSEC
    for tick in range(1200):
        time_s, drift = float(tick), 9 * ARCSEC * np.sin(2 * np.pi * tick / 5700)
        offset = drift + size * (time_s >= 703)
        noise = ARCSEC * np.array([1, 1, 11]) * rng.standard_normal((2, 3))
        found += detector.add('a', round(time_s * 1e9), noise[0], VARIANCE, NO_LAW)
        found += detector.add('b', round(time_s * 1e9) + 1, offset + noise[1], VARIANCE, NO_LAW)
    step, = found
    assert step.head == 'b' and abs(step.stamp_ns * 1e-9 - 703) <= 2 * BLOCK_S
    # Of the block of the step a part is before it.
    assert np.all(np.abs(step.size_rad - size) < 5 * step.sigma_rad + 0.1 * np.abs(size))


def test_slow_bending_is_no_step():
    detector, rng = StepDetector(('a', 'b')), np.random.default_rng(9)
    for tick in range(1500):
        offset = 9 * ARCSEC * np.sin(2 * np.pi * tick / 5700) * np.ones(3)
        assert not detector.add('a', tick * 10 ** 9, ARCSEC * rng.standard_normal(3), VARIANCE,
                                NO_LAW)
        assert not detector.add('b', tick * 10 ** 9, offset + ARCSEC * rng.standard_normal(3),
                                VARIANCE, NO_LAW)


def test_bending_by_a_known_law_and_noise_that_grows_are_no_steps():
    # As before a blinding: fewer and fewer stars for 30 s, after which there are none.
    detector, rng = StepDetector(('a', 'b')), np.random.default_rng(7)
    for tick in range(1500):
        temperature_k = 10 * np.sin(2 * np.pi * tick / 600)
        sigma = ARCSEC * np.array([1, 1, 11]) * (30 if tick % 300 >= 270 else 1)
        for head, offset in (('a', 0.0), ('b', 0.9 * ARCSEC * temperature_k)):
            assert not detector.add(head, tick * 10 ** 9, offset + sigma * rng.standard_normal(3),
                                    sigma ** 2, np.array([temperature_k]))


def test_the_misalignment_is_about_body_axes():
    mount = Mount(MOUNT, law=np.array([[1e-5, 0, 0], [0, 0, 0], [0, 0, 0]]),
                  law_covariance=np.zeros((12, 12)), temperature_c=20.0)
    fusion = AttitudeFusion({'a': Mount(MOUNT), 'b': mount}, mount_options=MountOptions(
        mount_temperature_arcsec_k=1.0))
    fusion.heads['b'].set_temperature(30.0)
    bent = multiply(fusion.mounts.at('b', 0)[0], conjugate(MOUNT))
    np.testing.assert_allclose(2 * bent[:3], [1e-4, 0, 0], atol=1e-12)
    assert not fusion.heads['b'].set_temperature(float('nan'))
    # In kelvin.
    assert not fusion.heads['b'].set_temperature(293.15)


def test_a_law_of_the_file_counts_where_none_is_learnt():
    law = np.array([[1e-5, 0, 0], [0, 2e-5, 0], [0, 0, 0]])
    learnt = Mount(MOUNT, law=law, law_covariance=np.eye(12) * 1e-14, temperature_c=20.0)
    fusion = AttitudeFusion({'a': Mount(MOUNT), 'b': learnt})
    assert fusion.heads['b'].needs_temperature and not fusion.heads['a'].needs_temperature
    fusion.heads['b'].set_temperature(21.0)
    assert not fusion.heads['b'].needs_temperature
    bent, covariance = fusion.mounts.misalignment('b', 0)
    np.testing.assert_allclose(bent, [1e-5, 2e-5, 0], atol=1e-15)
    np.testing.assert_allclose(np.diag(covariance), 3e-14)


def test_the_basis_lasts_over_a_restart():
    np.testing.assert_allclose(basis(5700 * 10 ** 9 * 3 + 1425 * 10 ** 9, 2.0, 5700.0),
                               [1, 2, 0, 1], atol=1e-12)


@pytest.mark.parametrize(('text', 'words'), [
    ('heads: [', 'no YAML'), ('a: 1', 'no heads:'), ('heads: {b: {}}', 'no mount of a; it has b'),
    ('heads: {a: 3}', 'a is no mapping'), ('heads: {a: {}}', 'a has no quaternion'),
    ('heads: {a: {quaternion: [0, 0, 0]}}', 'quaternion of a must be 4 finite numbers'),
    ('heads: {a: {quaternion: [0, 0, 0, .nan]}}', '4 finite numbers'),
    ('heads: {a: {quaternion: [0, 0, 1, 1]}}', 'norm 1.4142'),
    ('heads: {a: {quaternion: [0, 0, 0, 1], time_offset_s: x}}', 'time_offset_s of a'),
    ('heads: {a: {quaternion: [0, 0, 0, 1], covariance_arcsec2: [-1, 0, 0, 0, 1, 0, 0, 0, 1]}}',
     'covariance_arcsec2 of a is no covariance')])
def test_a_wrong_file_is_named(tmp_path, text, words):
    path = tmp_path / 'mounts.yaml'
    path.write_text(text)
    with pytest.raises(MountError, match='mounts file .*mounts.yaml') as caught:
        load_mounts(path, ('a',))
    assert words in str(caught.value)
    with pytest.raises(MountError, match='No such file'):
        load_mounts(tmp_path / 'none.yaml', ('a',))
