# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The comparison of centroids: fair images, a bound that is one, checks that can fail."""

import json

from commands import invoke
import numpy as np
import pytest
from startracker_evaluation.bench.centroid import bounds, Ours, PEERS, Tally
from startracker_evaluation.bench.star_images import flux_e, SIZE_PX, star_image, STARS


def test_images_are_as_described_and_repeatable():
    scene, same = (star_image(30, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(scene.image, same.image)
    assert scene.image.shape == (SIZE_PX, SIZE_PX) and scene.image.dtype == np.uint16
    assert len(scene.uv) == STARS
    left, right = (np.median(scene.image[:, part]) for part in (slice(64), slice(-64, None)))
    assert right - left == pytest.approx(20, abs=3)
    assert np.std(scene.image[:, 500:520]) == pytest.approx(300 ** 0.5, rel=0.2)


@pytest.mark.parametrize('snr, bound_px', [(10, 0.125), (100, 0.0104)])
def test_the_bound(snr, bound_px):
    assert star_image(snr, np.random.default_rng(1)).bound_px.mean() == pytest.approx(
        bound_px, rel=0.03)
    assert flux_e(100) == pytest.approx(12009, abs=1)


def test_stars_are_counted_once():
    scene = star_image(100, np.random.default_rng(2))
    tally = Tally(cpu_s=[0.001])
    tally.count(scene, np.concatenate([scene.uv[1:] + 0.01, [[3.0, 3.0]], scene.uv[1:2] + 0.5]))
    figures = tally.figures
    assert figures['found_percent'] == pytest.approx(100 * 29 / 30)
    assert figures['false_per_image'] == 2
    assert figures['rms_over_bound'] == pytest.approx(0.01 / scene.bound_px.mean(), rel=0.05)


def test_ours_is_near_the_bound():
    tally, ours, rng = Tally(), Ours(), np.random.default_rng(3)
    for _ in range(8):
        scene = star_image(100, rng)
        tally.cpu_s.append(0.0)
        tally.count(scene, ours.uv(ours.extract(scene.image)))
    figures = tally.figures
    assert figures['found_percent'] == 100 and figures['false_per_image'] <= 0.25
    assert figures['rms_over_bound'] == pytest.approx(1, abs=0.12)


def test_each_bound_can_fall_short():
    good = {'found_percent': 99.9, 'false_per_image': 0.0, 'rms_over_bound': 1.0,
            'median_ms': 1.5}
    peer = {**good, 'median_ms': 1.6}
    assert all(holds for _, holds in bounds(10, {'ours': good, 'tetra3rs': peer}))
    for name, value in (('found_percent', 99.0), ('false_per_image', 0.2),
                        ('rms_over_bound', 1.06), ('median_ms', 1.7), ('median_ms', 2.1)):
        checks = bounds(10, {'ours': {**good, name: value}, 'tetra3rs': peer})
        assert not all(holds for _, holds in checks), (name, value)


def test_the_command_runs_all_that_is_installed():
    done = invoke('bench', 'centroid', '--trials', '1', '--snr', '100', '--json')
    rows = {row['extractor']: row for row in json.loads(done.stdout)['rows']}
    assert {'ours', 'memcpy', 'np.max'} <= set(rows) <= {*PEERS, 'memcpy', 'np.max'}
    assert rows['ours']['found_percent'] == 100
    assert all(row['found_percent'] >= 90 for name, row in rows.items() if name in PEERS)
