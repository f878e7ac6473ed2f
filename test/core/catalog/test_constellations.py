# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lines of the constellations are between their stars, and they have their names."""

from astropy.coordinates import get_constellation, SkyCoord
import numpy as np
from startracker_ros.core.catalog.constellations import FIGURES, NAMES
from startracker_ros.core.catalog.stars import load_catalog

# Alpheratz is a corner of the square of Pegasus, Elnath one of the pentagon of Auriga.
SHARED = {('Peg', 677): 'And', ('Aur', 25428): 'Tau'}


def test_every_star_is_bright_and_within_the_boundaries_of_the_iau():
    catalog = load_catalog().brighter_than(5.0)
    named = [(name, hip) for name, lines in FIGURES.items()
             for hip in {hip for line in lines for hip in line}]
    place = {int(hip): index for index, hip in enumerate(catalog.hip)}
    index = [place[hip] for _, hip in named]
    found = get_constellation(SkyCoord(catalog.ra_rad[index], catalog.dec_rad[index], unit='rad'),
                              short_name=True)
    for (name, hip), constellation in zip(named, found):
        assert constellation == SHARED.get((name, hip), name), (name, hip)
    # A star of each that is not shared.
    first = [place[lines[0][-1]] for lines in FIGURES.values()]
    names = get_constellation(SkyCoord(catalog.ra_rad[first], catalog.dec_rad[first], unit='rad'))
    assert [name.strip().replace('ö', 'o') for name in names] == [*NAMES.values()]
    assert [*NAMES] == [*FIGURES]


def test_no_line_is_drawn_twice_or_across_the_sky():
    catalog = load_catalog().brighter_than(5.0)
    place = {int(hip): index for index, hip in enumerate(catalog.hip)}
    direction = catalog.directions(2000.0)
    pairs = [pair for lines in FIGURES.values() for line in lines for pair in zip(line, line[1:])]
    assert len({frozenset(pair) for pair in pairs}) == len(pairs) > 150
    lengths_rad = [np.linalg.norm(direction[place[a]] - direction[place[b]]) for a, b in pairs]
    assert min(lengths_rad) > 0.01 and max(lengths_rad) < np.radians(21)
