# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of a trend in Chromium: steps over a month, and a run of seconds."""

from browser import assert_readable, Page
import numpy as np
import pytest
from startracker_ros.tools.trend.series import Series
from startracker_ros.tools.trend.steps import find_steps
from startracker_ros.tools.trend.trend import drift_rows, PixelRow, trend_page

BEGIN_NS = 1_767_225_600 * 10 ** 9


def series_of(minutes: int) -> Series:
    rng = np.random.default_rng(1)
    values = rng.normal(0, 0.01, (minutes, 2))
    values[minutes // 2:, 0] += 0.1
    return Series('head_2 mount', 'arcsec', ('x', 'y'),
                  BEGIN_NS + 60 * 10 ** 9 * np.arange(minutes), values)


@pytest.mark.parametrize('minutes', [1, 2000])
def test_the_page_is_readable_on_phone_and_screen(page: Page, tmp_path, minutes):
    series = series_of(minutes)
    search = find_steps(series.stamp_ns, series.values, 5801.0)
    assert len(search.steps) == (minutes > 1)
    path = tmp_path / 'trend.html'
    path.write_text(trend_page('run', [(series, search)], drift_rows(series, search), [], [
        PixelRow('head_1', *np.zeros(len(PixelRow.__dataclass_fields__) - 1, int).tolist())], []))
    assert_readable(page, path)
    assert page.count('.chart img') == (minutes > 1)
    assert ('too little data, 1 bins' in page.text('#series')) == (minutes == 1)
    assert page.text('#stars p') == 'none' and 'head_1' in page.text('#pixels')
