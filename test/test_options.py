# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options refuse what is out of range and say what the range is."""

from dataclasses import dataclass

import pytest
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class Example(Options):
    rate_hz: float = option(10.0, 'frames a second', unit='Hz', low=0.1, high=1000.0)
    method: str = option('gaussian', 'how', choices=('gaussian', 'grey'))
    rate_deg_s: tuple = option((0.0, 0.1, 0.0), 'body rate', unit='deg/s', low=-10.0, high=10.0)
    count: int = option(3, 'how many', low=1)
    noisy: bool = option(True, 'noise on')


def test_values_are_taken_in_the_type_of_the_default():
    example = Example(rate_hz=5, rate_deg_s=[0.0, 0.0, 1.0])
    assert example.rate_hz == 5.0 and isinstance(example.rate_hz, float)
    assert example.rate_deg_s == (0.0, 0.0, 1.0)


@pytest.mark.parametrize('values, words', [
    ({'rate_hz': 0.0}, r'rate_hz = 0.0 is out of range 0.1 .. 1000 Hz'),
    ({'rate_hz': float('nan')}, 'rate_hz = nan is not finite'),
    ({'rate_hz': '10'}, 'rate_hz.*type str, must be float'),
    ({'method': 'best'}, "method = 'best' must be one of gaussian, grey"),
    ({'rate_deg_s': (0.0, 20.0, 0.0)}, 'rate_deg_s.*-10 .. 10'),
    ({'rate_deg_s': (0.0, 20.0)}, 'rate_deg_s'),
    ({'count': 0}, 'count = 0 is out of range 1 .. inf'),
    ({'count': True}, 'count'),
    ({'noisy': 1}, 'noisy'),
])
def test_refusals_name_option_and_range(values, words):
    with pytest.raises(ValueError, match=words):
        Example(**values)


def test_table_rows_carry_unit_and_description():
    row = Example.table()[0]
    assert (row.name, row.default, row.unit, row.range_text) == (
        'rate_hz', 10.0, 'Hz', '0.1 .. 1000')
