# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""K-vector ranges against a sorted search."""

from hypothesis import example, given, strategies as st
from native_core import kernels
import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.pairs import build_pairs, steps_below

# Few different values, so that repeats and hits on the ends are common; none finer than any
# separation in rad can be.
number = st.one_of(st.floats(-2, 2).map(lambda value: round(value, 14)),
                   st.integers(-8, 8).map(lambda n: n / 4))
# The ends of a range may lie anywhere.
anywhere = st.one_of(number, st.floats(-1e300, 1e300), st.sampled_from([-np.inf, np.inf]))


@st.composite
def clustered(draw):
    """Return sorted values, some of them hundreds of times; perhaps none, perhaps all alike."""
    values = sorted(draw(st.lists(number, max_size=30)))
    repeats = [draw(st.sampled_from([1, 1, 1, 2, 700])) for _ in values]
    return np.repeat(np.array(values, float), repeats)


def between(values, below, low, high):
    """Return the range of sorted values that the native core finds."""
    found = np.empty(2, np.int32)
    kernels().stt_range(values.ctypes.data, below.ctypes.data, len(values), low, high,
                        found.ctypes.data)
    return slice(*found.tolist())


def assert_right(values, low, high):
    found = between(values, steps_below(values), low, high)
    begin, end = np.searchsorted(values, low, 'left'), np.searchsorted(values, high, 'right')
    if begin < end:
        assert (found.start, found.stop) == (begin, end)
    else:
        assert 0 <= found.start == found.stop <= len(values)


@given(clustered(), anywhere, anywhere)
@example(np.empty(0), -np.inf, np.inf)
@example(np.zeros(1), 0.0, 0.0)
@example(np.full(5000, 0.25), 0.25, 0.25)
@example(np.full(5000, 0.25), -np.inf, np.inf)
@example(np.full(5000, 0.25), 0.26, 0.3)
@example(np.array([1.0, 2.0, 3.0]), 2.5, 2.6)
@example(np.array([1.0, 2.0, 3.0]), 3.5, 1e300)
@example(np.array([1.0, 2.0, 3.0]), -1e300, 0.5)
@example(np.repeat([0.0, 1e-9, 1.0], [3000, 3000, 1]), 1e-9, 1e-9)
def test_ranges_agree_with_a_sorted_search(values, low, high):
    assert_right(values, min(low, high), max(low, high))


@given(clustered().filter(len), st.data())
def test_ranges_that_end_on_values_or_just_beside_them(values, data):
    value = st.sampled_from(values.tolist())
    low, high = sorted([data.draw(value), data.draw(value)])
    assert_right(values, low, high)
    assert_right(values, np.nextafter(low, 3), np.nextafter(high, -3))
    assert_right(values, np.nextafter(low, -3), np.nextafter(high, 3))


def test_many_values():
    rng = np.random.default_rng(1)
    values = np.sort(rng.uniform(0, 0.3, 200_000) ** 2)
    below = steps_below(values)
    for low, high in np.sort(rng.uniform(-0.01, 0.1, (200, 2)), axis=1):
        found = between(values, below, low, high)
        assert found.start == np.searchsorted(values, low, 'left')
        assert found.stop == np.searchsorted(values, high, 'right')


def test_separations_are_numbers_even_where_stars_coincide():
    """Stars at one place, and as far apart as any field reaches."""
    rng = np.random.default_rng(2)
    direction = rng.standard_normal((200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.concatenate([direction, direction[:50], -direction[:50]])
    onboard = OnboardCatalog(np.arange(1, 301, dtype=np.int32), direction, np.full(300, 5.0),
                             *np.zeros((2, 300), bool))
    separation = build_pairs(onboard, 0.0, 3.0).separation
    assert np.isfinite(separation).all()
    assert np.count_nonzero(separation == 0) == 50
    assert_right(separation, 0.0, 0.0)
    assert_right(separation, -1.0, 4.0)
