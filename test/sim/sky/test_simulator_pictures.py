# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of the documentation: there, small, and of the effect they name."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from simulator_pictures import draw, PICTURES, TITLE_PX

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
    assert (np.abs(drawn - shown)[TITLE_PX:] > 5).mean() < 1e-3
    # Versions of OpenCV have fonts of their own.
    ink = [(title > 100).any(axis=(0, 2)).sum() for title in (drawn[:TITLE_PX], shown[:TITLE_PX])]
    assert ink[0] == pytest.approx(ink[1], rel=0.2) and ink[0] > 50
    if not PICTURES[name].overlay:
        halves = drawn[TITLE_PX:]
        assert (halves[:, :340] != halves[:, 346:]).any()


@pytest.mark.parametrize('name', ['coma', 'astigmatism', 'earth_limb', 'stray_light', 'harsh'])
def test_stars_are_seen_in_both_halves_under_their_titles(name):
    shown = cv2.imread(str(DOCS / 'pictures' / f'{name}.png'), cv2.IMREAD_GRAYSCALE)
    for half in (shown[:, :340], shown[:, 346:]):
        assert (half[:TITLE_PX] > 150).sum() > 50
        # Brighter than what is around, which may be the glow of a bright body.
        smooth = cv2.medianBlur(half[TITLE_PX:], 31)
        stars, _ = cv2.connectedComponents(np.uint8(half[TITLE_PX:] > smooth.astype(int) + 50))
        assert stars - 1 >= 4
