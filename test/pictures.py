# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What people see of a figure of matplotlib: its texts, on a page that shows it 900 px wide."""

from itertools import combinations
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox

PAGE_PX, LEAST_PX = 900, 10


def assert_legible(figure: Any) -> None:
    """Assert that texts are large enough, within the figure, and that none covers another."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    width, height = figure.bbox.size
    draw, lines = renderer.draw_text, []

    def draw_text(gc: Any, x: float, y: float, text: str, font: Any, angle: float,
                  ismath: Any = False, mtext: Any = None) -> None:
        assert angle in (0, 90)
        # x, y is where the baseline begins; the descent is part of the height.
        along, across, descent = renderer.get_text_width_height_descent(text, font, ismath)
        box = Bbox.from_bounds(x, y + descent, along, -across) if angle == 0 else (
            Bbox.from_bounds(x + descent, y, -across, -along))
        lines.append((text, font.get_size_in_points() / 72 * figure.dpi, box))
        draw(gc, x, y, text, font, angle, ismath, mtext)
    renderer.draw_text = draw_text
    figure.draw(renderer)
    assert lines
    for text, size_px, box in lines:
        assert size_px * PAGE_PX / width >= LEAST_PX, text
        assert box.xmin >= 0 and box.xmax <= width and box.ymin >= 0 and box.ymax <= height, text
    for (one, _, first), (other, _, second) in combinations(lines, 2):
        assert not first.overlaps(second), (one, other)
