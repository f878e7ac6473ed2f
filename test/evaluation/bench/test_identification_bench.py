# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fields of close pairs and of false spots that stayed unidentified, and how they are made."""

import json
from types import SimpleNamespace

from commands import invoke
import numpy as np
import pytest
from startracker_evaluation.bench import lost_in_space, narrow_field
from startracker_evaluation.bench.identification import (
    Case, CASES, EPOCH_YEAR, frame, imaged_sky, Outcome, run_identification_bench, solve_frames,
    VIEWS)
from startracker_evaluation.bench.lost_in_space import CORRECT, UNSOLVED, WRONG
from startracker_evaluation.bench.narrow_field import VIEWS as NARROW_VIEWS
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import quaternion_from_pointing
from startracker_ros.tools.figures.correctness import is_correct

MODELS = [name for name, case in CASES.items() if not case.false]
CRUX, KAPPA_CRUCIS, NU_DRACONIS = (187.0, -59.0), (193.4, -60.4), (263.1, 55.2)


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('camera, patch', [
    ('A12', CRUX), ('A12', KAPPA_CRUCIS), ('C10', NU_DRACONIS), ('C10', KAPPA_CRUCIS)])
def test_patches_of_close_pairs_are_identified(camera, patch, model):
    rng = np.random.default_rng(1)
    view = VIEWS[camera]
    identifier = make_identifier(view.camera, EPOCH_YEAR, IdentificationOptions(
        magnitude_limit=view.magnitude_limit))
    for _ in range(60):
        ra_deg, dec_deg = patch + rng.uniform(-3, 3, 2)
        q = quaternion_from_pointing(*np.radians([ra_deg, dec_deg, rng.uniform(0, 360)]))
        centroids, _ = star_list(imaged_sky(view, CASES[model]), view.camera, q,
                                 rng.uniform(0.05, 0.2), rng)
        attitude = identifier.identify(centroids).attitude
        assert attitude is not None and is_correct(attitude.quaternion, q)


def test_alpha_centauri_resolved_joined_and_without_its_companion():
    view, hip = VIEWS['A12'], load_catalog().hip
    a, b = 71683, 71681
    skies = [imaged_sky(view, case) for case in (Case(), Case(1.0), Case(1.0, drop=True))]
    resolved, joined, dropped = (sky.magnitude[sky.hip == a][0] for sky in skies)
    assert b in skies[0].hip and b not in skies[1].hip and b not in skies[2].hip
    assert resolved == dropped == pytest.approx(load_catalog().magnitude[hip == a][0])
    assert joined == pytest.approx(-0.28, abs=0.05)
    for sky in skies:
        assert np.all(np.diff(sky.magnitude) >= 0)
        np.testing.assert_allclose(np.linalg.norm(sky.direction, axis=1), 1, atol=1e-12)


def test_frames_have_their_false_spots_in_the_range_of_the_stars():
    rng = np.random.default_rng(2)
    bright, alike = (frame(VIEWS['D12'], CASES[name], rng)[0].flux
                     for name in ('100 bright false spots', '100 false spots'))
    assert 130 <= len(bright) <= 140 and 130 <= len(alike) <= 140
    # The upper half of the range holds half of the spots that are uniform in flux, and few stars.
    for flux, least, most in ((bright, 35, 70), (alike, 1, 20)):
        assert least <= np.count_nonzero(flux > (flux.min() + flux.max()) / 2) <= most


def test_a_hundred_bright_false_spots_are_not_an_obstacle():
    outcome = solve_frames(VIEWS['D12'], CASES['100 bright false spots'], 20, 3)
    assert outcome.correct.all()


def test_the_command_prints_rows_that_hold(one_process):
    done = invoke('bench', 'identification', '--trials', '100', '--json', '--only', 'resolved',
                  '--only', '100 bright false spots')
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert [row['case'] for row in document['rows']] == [
        f'{camera}, resolved: {figure}' for camera in VIEWS for figure in ('unsolved', 'wrong')
    ] + [f'D12, 100 bright false spots: {figure}'
         for figure in ('solved', 'time, median', 'wrong')]
    assert document['conditions']['trials'] == 100


@pytest.mark.parametrize('case, solved, correct, failing', [
    ('resolved', [True, True], [True, True], []),
    ('resolved', [True, False], [True, False], ['A12, resolved: unsolved']),
    ('resolved', [True, True], [True, False], ['A12, resolved: wrong']),
])
def test_bounds_can_fail(monkeypatch, case, solved, correct, failing):
    outcome = Outcome(np.array(solved), np.array(correct), np.full(2, 1e-3))
    monkeypatch.setattr('startracker_evaluation.bench.identification.parallel_trials',
                        lambda work, cases, *_, **__: [
                            outcome if view.name == 'A12' else Outcome(*np.ones((3, 2), bool))
                            for view, _ in cases])
    result = run_identification_bench(trials=2, seed=1, only=(case,))
    assert [row.case for row in result.rows if not row.holds] == failing


@pytest.mark.parametrize(('count', 'all_but'), [
    (8, 0), pytest.param(60, 2, marks=pytest.mark.long)])
def test_narrow_fields_are_identified_with_the_deep_catalogue(count, all_but):
    for view, least in zip(NARROW_VIEWS.values(), (count, count - all_but)):
        outcome = narrow_field.solve_frames(view, count, 3)
        assert np.count_nonzero(outcome.kind == CORRECT) >= least
        assert not np.any(outcome.kind == WRONG)


def test_narrow_bounds_can_fail(monkeypatch):
    kinds = {'N3': [CORRECT, UNSOLVED], 'N2': [CORRECT, WRONG]}
    monkeypatch.setattr(narrow_field, 'parallel_trials', lambda work, cases, *_, **__: [
        lost_in_space.Outcome(np.array(kinds[view.name]), np.array([1e-3, 1.0]))
        for view, in cases])
    monkeypatch.setattr(narrow_field, 'measure_build', lambda view: (
        (2.0, 50.0) if view.name == 'N3' else (4.0, 150.0)))
    monkeypatch.setattr(narrow_field, 'Processes', InThisProcess)
    failing = [row.case for row in narrow_field.narrow_field_rows(trials=2, seed=1)
               if not row.holds]
    assert failing == ['N3: correct', 'N3: time, median', 'N3: time, p99', 'N2: correct',
                       'N2: wrong', 'N2: time, median', 'N2: time, p99', 'N2: database, time',
                       'N2: database, memory']


class InThisProcess:
    """The part of an executor that the bench uses."""

    def __init__(self, *_, **__) -> None:
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        pass

    def submit(self, work, *arguments):
        return SimpleNamespace(result=lambda: work(*arguments))
