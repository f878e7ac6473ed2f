"""The pictures of the documentation: there, small, and of the effect they name."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from startracker_ros.sim.sky.gallery import draw, PICTURES

DOCS = Path(__file__).parents[3] / 'docs'


def test_every_picture_is_shown_and_small():
    page = (DOCS / 'simulator.md').read_text()
    files = {file.stem: file for file in (DOCS / 'pictures').glob('*.png')}
    for name in PICTURES:
        assert f'(pictures/{name}.png)' in page
        assert files[name].stat().st_size < 60_000
    assert page.count('(pictures/') == len(PICTURES)


@pytest.mark.parametrize('name', ['hot_pixels', 'full_well', 'aberration'])
def test_pictures_are_those_of_the_command(name):
    shown = cv2.imread(str(DOCS / 'pictures' / f'{name}.png'))
    drawn = draw(PICTURES[name]).astype(int)
    # Another processor may round one pixel in a thousand to the next grey.
    assert (np.abs(drawn - shown) > 5).mean() < 1e-3
    if not PICTURES[name].overlay:
        assert (drawn[:, :340] != drawn[:, 346:]).any()
