"""The picture of a run: nothing is drawn where there are no frames."""

import numpy as np
from startracker_ros.core.extras import new_figure
from startracker_ros.tools.report.picture import draw_error


def test_no_bounds_are_drawn_over_a_gap():
    axis = new_figure().add_subplot()
    time_s = np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(50.0, 52.0, 0.1)])
    draw_error(axis, time_s, np.zeros(len(time_s)), np.ones(len(time_s)), 'x', markersize=2)
    band, = axis.collections
    drawn = sorted(path.get_extents().intervalx.tolist() for path in band.get_paths())
    np.testing.assert_allclose(drawn, [[0.0, 2.9], [50.0, 51.9]])
    errors = axis.lines[0]
    assert errors.get_linestyle() == 'None'
    np.testing.assert_array_equal(errors.get_xdata(), time_s)
