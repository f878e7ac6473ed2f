# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every stage gives the outputs of its golden vectors, within their tolerances."""

import json

from golden_vectors import difference, FOLDER, plain, STAGES
import numpy as np
import pytest

CASES = [(path.stem, case) for path in sorted(FOLDER.glob('*.json'))
         for case in json.loads(path.read_text())['cases']]


def test_each_stage_has_its_vectors():
    assert {name for name, _ in CASES} == set(STAGES)
    for name, stage in STAGES.items():
        document = json.loads((FOLDER / f'{name}.json').read_text())
        assert document['does'] == stage.does
        assert document['tolerance'] == plain(stage.tolerance)


@pytest.mark.parametrize('name, case', CASES,
                         ids=[f'{name}-{case["name"]}' for name, case in CASES])
def test_outputs(name, case):
    stage, expected = STAGES[name], case['output']
    found = plain(stage.outputs(case['input']))
    assert set(found) == set(expected) == set(stage.tolerance)
    over = {key: difference(key, expected[key], found[key], stage.tolerance[key])
            for key in expected}
    assert max(over.values()) <= 1, over


@pytest.mark.parametrize('name, expected, found, tolerance, over', [
    ('uv', [1.0, -2.0], [1.0, -2.1], (0.1, 0.0), 0.5),
    ('uv', [1.0, None], [1.5, None], (0.0, 0.1), 5.0),
    ('uv', [1.0, None], [1.0, 2.0], (0.0, 0.1), np.inf),
    ('uv', [1.0], [1.0, 2.0], (0.0, 0.1), np.inf),
    ('hip', [1, 2], [1, 3], (0.0, 0.0), np.inf),
    ('quaternion', [0.6, 0.0, 0.0, 0.8], [-0.6, 0.0, 0.0, -0.8], (0.0, 1e-9), 0.0)])
def test_differences_count(name, expected, found, tolerance, over):
    assert difference(name, expected, found, tolerance) == pytest.approx(over)
