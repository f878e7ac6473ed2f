# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frequency and delay of a topic, with a clock of the test."""

from types import SimpleNamespace

import pytest
from startracker_ros.ros import topic_status
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.topic_status import TopicStatus


@pytest.fixture
def now(monkeypatch):
    """Return a steady clock that stands still until the test moves it."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(topic_status.time, 'monotonic', lambda: now.s)
    return now


def status_at(now):
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=round(now.s * 1e9)))
    return TopicStatus(clock)


def second(now, status, messages, *, delay_s=0.02, missing=0):
    """Let a second pass with messages, and return the status at its end."""
    for k in range(messages):
        now.s += 1 / (messages + 1)
        status.arrived(round((now.s - delay_s) * 1e9), missing if k == 0 else 0)
    now.s += 1 / (messages + 1)
    return status.run()


def test_frequency_and_delay_are_those_of_the_last_five_seconds(now):
    status = status_at(now)
    second(now, status, 2, delay_s=0.3)
    for _ in range(4):
        second(now, status, 10)
    level, message, values = second(now, status, 10)
    assert (level, message) == (OK, 'Desired frequency met')
    assert values['Events in window'] == 50 and values['Events since startup'] == 52
    assert float(values['Actual frequency (Hz)']) == pytest.approx(10)
    assert float(values['Latest timestamp delay:']) == pytest.approx(0.02, abs=1e-6)


def test_missing_messages_are_a_warning_for_five_seconds(now):
    status = status_at(now)
    second(now, status, 10)
    assert second(now, status, 10, missing=3)[:2] == (WARN, 'Frequency too low.')
    results = [second(now, status, 10) for _ in range(5)]
    assert [level for level, *_ in results] == [WARN] * 4 + [OK]
    assert results[0][2]['Missing in window'] == 3


def test_silence_is_a_warning_and_a_restart_begins_anew(now):
    status = status_at(now)
    assert status.run()[:2] == (WARN, 'No events recorded.')
    second(now, status, 10)
    for _ in range(5):
        level, message, values = second(now, status, 0)
    assert (level, message) == (WARN, 'No events recorded.')
    assert 'Latest timestamp delay:' not in values
    second(now, status, 10, missing=2)
    status.restart()
    assert second(now, status, 10)[0] == OK
