# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gaps, silence and jumps of time, found by the stamps and arrivals of frames."""

import pytest
from startracker_ros.ros.cadence import Cadence

STEP_NS = 100_000_000


@pytest.fixture
def cadence():
    """Return a cadence of ten frames at 10 Hz that arrived as they were taken."""
    cadence = Cadence()
    for index in range(10):
        assert cadence.arrived(index * STEP_NS, index * 0.1) == (0, 0.0)
    return cadence


def test_missing_frames_are_counted(cadence):
    assert cadence.arrived(12 * STEP_NS, 1.2) == (2, 0.0)
    assert cadence.arrived(13 * STEP_NS, 1.3) == (0, 0.0)


def test_a_clock_that_is_set_ahead_is_told_from_a_pause(cadence):
    missing, ahead_s = cadence.arrived(9 * STEP_NS + 60 * 10 ** 9, 1.0)
    assert missing == 0 and ahead_s == pytest.approx(59.9)
    assert cadence.arrived(19 * STEP_NS + 60 * 10 ** 9, 2.0) == (9, 0.0)


def test_silence_depends_on_what_is_usual(cadence):
    assert not cadence.is_silent(1.8)
    assert cadence.is_silent(2.0)
    slow = Cadence()
    for index in range(5):
        slow.arrived(index * 60 * 10 ** 9, index * 60.0)
    assert not slow.is_silent(240 + 120)
    assert slow.is_silent(240 + 301)


def test_a_recording_played_fast_is_not_a_jump():
    cadence = Cadence()
    for index in range(20):
        assert cadence.arrived(index * STEP_NS, index * 0.001) == (0, 0.0)


def test_a_new_rate_becomes_usual(cadence):
    for index in range(20):
        cadence.arrived(9 * STEP_NS + index * 10 * STEP_NS, 0.9 + index)
    assert cadence.arrived(9 * STEP_NS + 200 * STEP_NS, 20.9) == (0, 0.0)
    assert not cadence.is_silent(23.0)
