"""K-vector ranges against a sorted search."""

from hypothesis import given, strategies as st
import numpy as np

from startracker_ros.identify.kvector import KVector

# Few different values, so that repeats and hits on the ends are common.
number = st.one_of(st.floats(-2, 2), st.integers(-8, 8).map(lambda n: n / 4))


@given(st.lists(number, min_size=1, max_size=60), number, number)
def test_ranges_agree_with_a_sorted_search(values, low, high):
    values = np.sort(values)
    low, high = min(low, high), max(low, high)
    found = KVector(values).range(low, high)
    begin, end = np.searchsorted(values, low, 'left'), np.searchsorted(values, high, 'right')
    assert (found.start, found.stop) == (begin, end) or begin == end == found.start == found.stop


def test_many_values():
    rng = np.random.default_rng(1)
    values = np.sort(rng.uniform(0, 0.3, 200_000) ** 2)
    kvector = KVector(values)
    for low, high in np.sort(rng.uniform(-0.01, 0.1, (200, 2)), axis=1):
        found = kvector.range(low, high)
        assert found.start == np.searchsorted(values, low, 'left')
        assert found.stop == np.searchsorted(values, high, 'right')


def test_an_empty_range_is_empty():
    found = KVector(np.array([1.0, 2.0, 3.0])).range(2.5, 2.6)
    assert found.start == found.stop


def test_without_values_every_range_is_empty():
    found = KVector(np.empty(0)).range(0.1, 0.2)
    assert (found.start, found.stop) == (0, 0)
