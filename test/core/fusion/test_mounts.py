# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mounts: estimated in flight, their steps, and the file."""

import numpy as np
import pytest
from startracker_evaluation.campaign.heads_scene import NAMES, Scene, SceneRun, START_NS
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.head import HeadFrame
from startracker_ros.core.fusion.mounts import (
    load_mounts, Mount, MountError, MountOptions, save_mounts)
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, matrix_from_quaternion, multiply,
    quaternion_from_rotation_vector, random_attitude)

MOUNT = np.array([0.5, 0.5, 0.5, 0.5])
KNOWN = MountOptions(mount_sigma_arcsec=0.0, mount_walk_arcsec_sqrt_h=0.0)


def learn(scene, options, seed=6):
    run = SceneRun(scene, np.random.default_rng(seed))
    fusion = AttitudeFusion(run.mount_file(), FusionOptions(), options)
    return fusion, list(run.events(fusion))


def test_an_orbit_of_bending_is_estimated_and_lasts_in_the_file(tmp_path):
    period_s = 100.0
    scene = Scene(2 * period_s, period_s=1.0, orbit_s=period_s, bend_arcsec=20.0)
    options = MountOptions(mount_sigma_arcsec=3.0, mount_orbit_arcsec=20.0,
                           orbit_period_s=period_s, mount_walk_arcsec_sqrt_h=0.1)
    fusion, outcomes = learn(scene, options)
    stamp_ns, truth = outcomes[-1].fused.stamp_ns, outcomes[-1].misalignment
    save_mounts(fusion.mounts.estimated(), tmp_path / 'mounts.yaml')
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


def test_bending_with_the_temperature_is_estimated():
    scene = Scene(300.0, period_s=1.0, temperature_arcsec_k=1.0)
    fusion, outcomes = learn(scene, MountOptions(
        mount_sigma_arcsec=3.0, mount_temperature_arcsec_k=1.0, mount_walk_arcsec_sqrt_h=0.1))
    stamp_ns, truth = outcomes[-1].fused.stamp_ns, outcomes[-1].misalignment
    for head in (1, 2):
        error = fusion.mounts.misalignment(NAMES[head], stamp_ns)[0] - truth[head]
        assert np.linalg.norm(error) < 0.3 * np.linalg.norm(truth[head])


def test_a_mount_is_frozen_when_its_head_is_alone():
    fusion, outcomes = learn(Scene(20.0), MountOptions(mount_sigma_arcsec=3.0))
    before = fusion.mounts.misalignment('head_2', 0)
    run = SceneRun(Scene(1.0, heads=2), np.random.default_rng(7))
    # Frames of one head tell nothing of the difference of two.
    last = outcomes[-1].fused
    other = fusion.heads['head_2']
    q = multiply(last.quaternion, run.mounts[1])
    for index in range(1, 50):
        fusion.add_frame('head_2', HeadFrame(
            last.stamp_ns + index * 200_000_000, q, np.eye(3) * (5 * ARCSEC) ** 2))
    after = fusion.mounts.misalignment('head_2', 0)
    assert other.counts['used'] > 80
    # The covariance does not shrink, but grows with the random walk.
    assert np.trace(after[1]) > 0.8 * np.trace(before[1])


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


def test_a_law_of_the_file_counts_where_none_is_estimated():
    law = np.array([[1e-5, 0, 0], [0, 2e-5, 0], [0, 0, 0]])
    estimated = Mount(MOUNT, law=law, law_covariance=np.eye(12) * 1e-14, temperature_c=20.0)
    fusion = AttitudeFusion({'a': Mount(MOUNT), 'b': estimated})
    assert fusion.heads['b'].needs_temperature and not fusion.heads['a'].needs_temperature
    fusion.heads['b'].set_temperature(21.0)
    assert not fusion.heads['b'].needs_temperature
    bent, covariance = fusion.mounts.misalignment('b', 0)
    np.testing.assert_allclose(bent, [1e-5, 2e-5, 0], atol=1e-15)
    np.testing.assert_allclose(np.diag(covariance), 3e-14)


def test_the_phase_of_the_orbit_counts_from_stamp_0_and_lasts_over_a_restart():
    law = np.array([[0, 0, 0], [1e-5, 0, 0], [0, 2e-5, 0]])
    fusion = AttitudeFusion({'a': Mount(MOUNT), 'b': Mount(
        MOUNT, law=law, law_covariance=np.zeros((12, 12)))})
    for quarters, bent in ((12, [1e-5, 0, 0]), (13, [0, 2e-5, 0]), (14, [-1e-5, 0, 0])):
        found, _ = fusion.mounts.misalignment('b', quarters * 1425 * 10 ** 9)
        np.testing.assert_allclose(found, bent, atol=1e-17)


def test_heads_on_bent_mounts_agree_on_the_attitude_of_the_body():
    """q_icrf_from_body = q_icrf_from_sensor q_sensor_from_body, its covariance M C M^T."""
    rng = np.random.default_rng(9)
    q, mounts = random_attitude(rng), [random_attitude(rng) for _ in range(2)]
    bend = np.array([3e-4, -2e-4, 1e-4])
    fusion = AttitudeFusion({'a': Mount(mounts[0]), 'b': Mount(
        mounts[1], law=np.array([bend, np.zeros(3), np.zeros(3)]),
        law_covariance=np.zeros((12, 12)), temperature_c=20.0)}, mount_options=KNOWN)
    assert fusion.heads['b'].set_temperature(21.0)
    mounts[1] = multiply(quaternion_from_rotation_vector(bend), mounts[1])
    C, information = np.diag([1.0, 4.0, 100.0]) * ARCSEC ** 2, np.zeros((3, 3))
    for name, stamp_ns, mount in zip(
            'aab', START_NS + 10 ** 9 * np.array([0, 1, 1]), [mounts[0], *mounts]):
        fused = fusion.add_frame(name, HeadFrame(int(stamp_ns), multiply(q, mount), C))
    assert np.linalg.norm(attitude_error(fused.quaternion, q)) < 1e-12
    for mount in mounts:
        M = matrix_from_quaternion(mount)
        information += np.linalg.inv(M @ C @ M.T)
    np.testing.assert_allclose(fused.covariance, np.linalg.inv(information), rtol=2e-3)


@pytest.mark.parametrize(('text', 'words'), [
    ('heads: [', 'no YAML'), ('a: 1', 'no heads:'), ('heads: {b: {}}', 'no mount of a; it has b'),
    ('heads: {a: 3}', 'a is not a mapping'), ('heads: {a: {}}', 'a has no quaternion'),
    ('heads: {a: {quaternion: [0, 0, 0]}}', 'quaternion of a must be 4 finite numbers'),
    ('heads: {a: {quaternion: [0, 0, 0, .nan]}}', '4 finite numbers'),
    ('heads: {a: {quaternion: [0, 0, 1, 1]}}', 'norm 1.4142'),
    ('heads: {a: {quaternion: [0, 0, 0, 1], time_offset_s: x}}', 'time_offset_s of a'),
    ('heads: {a: {quaternion: [0, 0, 0, 1], covariance_arcsec2: [-1, 0, 0, 0, 1, 0, 0, 0, 1]}}',
     'covariance_arcsec2 of a is not a covariance')])
def test_a_wrong_file_is_named(tmp_path, text, words):
    path = tmp_path / 'mounts.yaml'
    path.write_text(text)
    with pytest.raises(MountError, match='mounts file .*mounts.yaml') as caught:
        load_mounts(path, ('a',))
    assert words in str(caught.value)
    with pytest.raises(MountError, match='No such file'):
        load_mounts(tmp_path / 'none.yaml', ('a',))
