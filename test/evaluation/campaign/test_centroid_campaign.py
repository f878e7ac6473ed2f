# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The centroid campaign: real stars, the paper's conclusions tested, figures repeated."""

import json

from commands import invoke
import numpy as np
import pytest
from startracker_evaluation.campaign.centroid import (
    conclusions, FACTORS, Photograph, without_lens)
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.extraction import WEIGHTS


@pytest.fixture(scope='module')
def document(sky_data, tmp_path_factory):
    output = tmp_path_factory.mktemp('centroid')
    done = invoke('campaign', 'centroid', '--json', '--images', str(sky_data / 'night-sky-11deg'),
                  '--trials', '50', '--seed', '3', '--output', str(output))
    assert done.exit_code == 0, done.output
    assert (output / 'thresholds.png').stat().st_size > 1000
    return json.loads(done.stdout)


def test_the_fit_is_nearest_to_the_sky(document):
    rows = {row['case']: row for row in document['rows']}
    right, double = ({method: rows[f'{method}: scatter, {factor} times the right threshold']
                      for method in WEIGHTS} for factor in (1, 2))
    assert all(150 < row['as_published'] < 900 for row in right.values())
    assert right['binary']['beyond'] < 0.7 * min(row['as_published'] for row in right.values())
    assert right['binary']['paper'] == 'the least' and right['binary']['holds']
    # Twice the threshold leaves hardly more than the brightest pixel.
    assert all(double[method]['as_published'] > 1.3 * right[method]['as_published']
               for method in WEIGHTS)
    assert rows['thresholded: worst over right threshold']['beyond'] == 1


def test_the_conclusions_of_the_paper_are_tested(document):
    conditions = document['conditions']
    results = {key: text for key, text in conditions.items() if key.startswith('paper')}
    assert len(results) == 3 and set(results.values()) <= {'confirmed', 'not confirmed'}
    shares = [row['as_published'] for row in document['rows'] if row['case'].startswith('draws')]
    assert len(shares) == 3 and all(0 <= share <= 100 and share % 2 == 0 for share in shares)
    assert conditions['seed'] == 3 and conditions['draws'].startswith('50 choices')


def test_conclusions_follow_from_the_figures():
    as_published = {(method, name): value for method, values in {
        'binary': (1.0, 9.0, 9.0, 9.0), 'grey': (2.0, 4.0, 4.5, 5.0),
        'squared': (2.0, 5.0, 4.0, 4.0), 'thresholded': (2.0, 2.5, 2.5, 2.5)}.items()
        for name, value in zip(FACTORS, values)}
    assert all(conclusions(as_published).values())
    otherwise = {**as_published, ('binary', 'right'): 3.0, ('binary', 'half'): 1.0,
                 ('thresholded', 'half'): 20.0}
    assert not any(conclusions(otherwise).values())


def test_the_lens_is_taken_off():
    rng = np.random.default_rng(1)
    camera = Camera.from_fov(1024, 768, 11.4)
    images, seen = [], []
    for _ in range(3):
        uv = rng.uniform(0, 767, (60, 2))
        x = (uv - [camera.cx, camera.cy]) / camera.cx
        bent = uv + 2 * x * (x ** 2).sum(1, keepdims=True) + rng.normal(0, 1, 2)
        bent[7] = np.nan
        images.append(Photograph(np.empty((0, 0)), camera, uv, np.array([0.0, 0, 0, 1])))
        seen.append(bent)
    for photograph, uv in zip(images, without_lens(images, seen)):
        assert np.isnan(uv[7]).all()
        np.testing.assert_allclose(np.delete(uv - photograph.uv, 7, 0), 0, atol=1e-9)


def test_a_folder_without_solutions_is_an_error(tmp_path):
    done = invoke('campaign', 'centroid', '--images', str(tmp_path))
    assert done.exit_code == 1
    assert 'no solutions.csv' in done.stderr


def test_without_a_folder_it_says_what_to_name(monkeypatch):
    monkeypatch.delenv('STARTRACKER_DATA', raising=False)
    done = invoke('campaign', 'centroid')
    assert done.exit_code == 1
    assert '--images' in done.stderr and 'STARTRACKER_DATA' in done.stderr


def test_the_environment_names_a_larger_set(monkeypatch, tmp_path):
    monkeypatch.setenv('STARTRACKER_DATA', str(tmp_path))
    done = invoke('campaign', 'centroid')
    assert done.exit_code == 1
    assert 'night-sky-11deg: no solutions.csv' in done.stderr.replace('\n', '')
