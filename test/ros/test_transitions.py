# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each change of a condition is logged once, repeats and floods are not."""

from startracker_ros.ros.diagnostics import Transitions


def test_a_condition_is_told_when_it_changes_and_not_when_its_numbers_do():
    transitions = Transitions()
    lines = [transitions.line('OK', condition, 0.1 * k) for k, condition in enumerate([
        'LOST: waiting', 'LOST: waiting', '3 stars, 4.5e-3 px', '12 stars, -0.1 px',
        'LOST: waiting'])]
    assert lines == ['LOST: waiting', None, '3 stars, 4.5e-3 px', None, 'LOST: waiting']


def test_a_condition_that_swings_with_every_frame_does_not_flood_the_log():
    transitions = Transitions(burst=10, period_s=1.0)
    lines = [transitions.line(k % 2, ('good', 'bad')[k % 2], 0.01 * k) for k in range(10_000)]
    # The burst, and one a second for the hundred seconds.
    assert 105 <= sum(line is not None for line in lines) <= 111
    assert lines[:10] == ['good', 'bad'] * 5


def test_a_line_after_a_flood_says_how_many_changes_it_stands_for():
    transitions = Transitions(burst=1, period_s=1.0)
    assert transitions.line('OK', 'good', 0.0) == 'good'
    assert [transitions.line('OK', text, 0.1) for text in ('bad', 'good', 'bad')] == [None] * 3
    assert transitions.line('OK', 'good', 5.0) == 'good (3 changes before were not logged)'
    assert transitions.line('OK', 'bad', 10.0) == 'bad'
    assert transitions.line('WARN', 'bad', 11.0) == 'bad'
