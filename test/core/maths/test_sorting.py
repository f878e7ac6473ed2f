# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Order and median of a few values against NumPy."""

from hypothesis import given, strategies as st
import numpy as np
from startracker_ros.core.maths.sorting import sort_indices, upper_median

# Few different values, so that equal ones are common.
values = st.lists(st.integers(-4, 4).map(float), max_size=20).map(np.array)


@given(values.map(lambda few: few.astype(float)))
def test_the_order_is_that_of_a_stable_sort(few):
    order = np.arange(len(few))
    sort_indices(order, few)
    np.testing.assert_array_equal(order, np.argsort(few, kind='stable'))


@given(values.filter(len))
def test_the_median_is_the_upper_middle_value(few):
    assert upper_median(few) == np.sort(few)[len(few) // 2]


def test_the_values_stay_as_they_are():
    few = np.array([3.0, 1.0, 2.0])
    assert upper_median(few) == 2
    np.testing.assert_array_equal(few, [3, 1, 2])
