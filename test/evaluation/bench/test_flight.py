# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the core takes of a flight computer: memory, stack of frames, call graph."""

from pathlib import Path

import pytest
from startracker_evaluation.bench import flight

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def in_the_source_tree(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_memory_and_frames_are_measured():
    result = flight.run_flight_bench(trials=30, only=('memory', 'frame'))
    ours = {row.case: row.ours for row in result.rows}
    assert result.holds
    assert ours['memory, 512 px, 12 deg: all stages'] < ours['memory, 1024 px, 12 deg: all stages']
    assert ours['memory, 1024 px, 12 deg: trust'] < 1
    assert 2 < ours['stack, painted, x86-64: all of these frames'] < flight.MOST_STACK_KIB
    for kind in ('lost', 'tracking, predicted stars', 'lost, image full of false stars'):
        assert ours[f'frame, st_process_image, {kind}: median'] > 0


def test_the_deepest_chain_of_calls_is_found_and_a_recursion():
    graph = flight.CallGraph()
    graph.read('\n'.join([
        *(f'node: {{ title: "{name}" label: "{name}()\\na.cpp:1:2\\n{size} bytes ({kind})" }}'
          for name, size, kind in (('a', 10, 'static'), ('b', 20, 'dynamic'),
                                   ('c', 5, 'dynamic,bounded'))),
        'node: { title: "sqrt" label: "sqrt\\nmath.h:1:2" shape : ellipse }',
        *(f'edge: {{ sourcename: "{one}" targetname: "{two}" label: "a.cpp:3:4" }}'
          for one, two in (('a', 'b'), ('a', 'c'), ('b', 'sqrt')))]))
    assert (graph.deepest('a'), graph.deepest('c'), graph.dynamic) == (30, 5, {'b'})
    again = flight.CallGraph()
    again.read('edge: { sourcename: "a" targetname: "b" }\n'
               'edge: { sourcename: "b" targetname: "a" }')
    with pytest.raises(ValueError, match='calls itself'):
        again.deepest('a')
