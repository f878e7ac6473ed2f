# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Constellations: names, boundaries, and lines between their stars."""

from astropy.coordinates import FK4, get_constellation, ICRS, SkyCoord
import numpy as np
from skyfield.api import load_constellation_map, load_constellation_names
from skyfield.api import position_of_radec
from startracker_ros.core.catalog.constellations import constellation_at, FIGURES, NAMES
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import ARCSEC, unit_from_radec

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
    assert {*FIGURES} <= {*NAMES}


def test_the_names_are_those_of_the_iau():
    names = {short: name.replace('ö', 'o') for short, name in load_constellation_names()}
    assert names == NAMES and len(NAMES) == 88


def test_places_of_the_publication_are_in_their_constellations():
    # The examples of the ReadMe of CDS catalogue VI/42.
    places = SkyCoord([9, 23.5, 5.12, 9.4555, 12.8888, 15.6687, 19, 6.2222],
                      [65, -20, 9.12, -19.9, 22, -12.1234, -40, -81.1234],
                      unit=('hour', 'deg'), frame=FK4(equinox='B1950')).transform_to(ICRS())
    found = [constellation_at(place) for place in unit_from_radec(places.ra.rad, places.dec.rad)]
    assert found == ['UMa', 'Aqr', 'Ori', 'Hya', 'Com', 'Lib', 'CrA', 'Men']


def test_every_place_of_the_sky_has_the_constellation_that_others_find():
    rng = np.random.default_rng(1)
    ra_rad, dec_rad = rng.uniform(0, 2 * np.pi, 4000), np.arcsin(rng.uniform(-1, 1, 4000))
    places = unit_from_radec(ra_rad, dec_rad)
    found = [constellation_at(place) for place in places]
    assert {*found} == {*NAMES}
    for others in (get_constellation(SkyCoord(ra_rad, dec_rad, unit='rad'), short_name=True),
                   load_constellation_map()(position_of_radec(np.degrees(ra_rad) / 15,
                                                              np.degrees(dec_rad)))):
        other = np.flatnonzero(others != found)
        assert len(other) < 5
        # astropy goes to B1875 with aberration, skyfield with nutation: some 20 arcsec.
        for index in other:
            around = places[index] + 30 * ARCSEC * rng.normal(size=(30, 3))
            assert others[index] in [constellation_at(place) for place in around]


def test_the_poles_and_the_first_hour_have_one():
    assert constellation_at(np.array([0.0, 0.0, 1.0])) == 'UMi'
    assert constellation_at(np.array([0.0, 0.0, -1.0])) == 'Oct'
    assert constellation_at(np.array([1.0, 0.0, 0.0])) == 'Psc'


def test_no_line_is_drawn_twice_or_across_the_sky():
    catalog = load_catalog().brighter_than(5.0)
    place = {int(hip): index for index, hip in enumerate(catalog.hip)}
    direction = catalog.directions(2000.0)
    pairs = [pair for lines in FIGURES.values() for line in lines for pair in zip(line, line[1:])]
    assert len({frozenset(pair) for pair in pairs}) == len(pairs) > 150
    lengths_rad = [np.linalg.norm(direction[place[a]] - direction[place[b]]) for a, b in pairs]
    assert min(lengths_rad) > 0.01 and max(lengths_rad) < np.radians(21)
