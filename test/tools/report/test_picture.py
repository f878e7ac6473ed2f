# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of runs: nothing is drawn where there are no frames, and texts are legible."""

from pathlib import Path

import numpy as np
from pictures import assert_legible
import pytest
from startracker_ros.core.extras import new_figure
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.tools.report.chart import draw_error
from startracker_ros.tools.report.summary import draw_run
from startracker_ros.tools.report.target import draw_target, TargetRecording

BAG = Path(__file__).parents[3] / 'bags' / 'slew'
IMAGE = np.zeros((1024, 1024), np.uint8)
UV, HIP = np.array([[200.0, 300.0], [520.0, 300.0], [100.0, 900.0]]), np.array([11767, 95347, 0])


@pytest.fixture
def drawn(monkeypatch):
    """Return a list that takes the figures instead of files."""
    figures = []
    monkeypatch.setattr('startracker_ros.tools.report.chart.write_picture',
                        lambda path, figure, **options: figures.append(figure))
    return figures


def located():
    """Return a target on a circle, located to 10 m."""
    angle = np.linspace(0, 0.1, 50)
    truth = 7e6 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    velocity = 7500 * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], -1)
    noise = np.random.default_rng(1).normal(0, 10, truth.shape)
    return TargetRecording(np.arange(50) * 10 ** 9, truth + noise, np.tile(100 * np.eye(3), (
        50, 1, 1)), truth, velocity, {})


@pytest.mark.parametrize('draw', [
    lambda: draw_run(Path('demo.png'), load_recording(BAG), IMAGE, UV, HIP, 'star tracker demo'),
    lambda: draw_target(Path('two.png'), located(), {
        name: (IMAGE, UV, HIP, np.array([500.0, 500.0])) for name in ('tracker_1', 'tracker_2')}),
], ids=['run', 'target'])
def test_texts_are_legible_at_the_width_of_a_page(drawn, draw):
    draw()
    figure, = drawn
    assert_legible(figure)


def test_no_bounds_are_drawn_over_a_gap():
    axis = new_figure().add_subplot()
    time_s = np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(50.0, 52.0, 0.1)])
    draw_error(axis, time_s, np.zeros(len(time_s)), np.ones(len(time_s)))
    band, = axis.collections
    drawn = sorted(path.get_extents().intervalx.tolist() for path in band.get_paths())
    np.testing.assert_allclose(drawn, [[0.0, 2.9], [50.0, 51.9]])
    errors = axis.lines[0]
    assert errors.get_linestyle() == 'None'
    np.testing.assert_array_equal(errors.get_xdata(), time_s)
