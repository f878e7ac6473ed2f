# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messier, NGC and IC objects in pictures."""

import sys

import cv2
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.extras import install_hint, MissingLibraryError
from startracker_ros.core.maths.rotation import quaternion_from_pointing, unit_from_radec
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.deep_sky import deep_sky_in
from startracker_ros.photographs.picture import annotated
from startracker_ros.photographs.solve import Outputs, solve_files

# (ra_deg, dec_deg, field in deg) and what has to be there: catalogued places known to anyone.
FIELDS = {
    'Andromeda': (10.7, 41.3, 11.0, ['M 31', 'M 110', 'M 32'], ['NGC 224', 'NGC 205']),
    'sword of Orion': (83.8, -5.0, 1.3, ['M 42', 'M 43', 'NGC 1977'], ['NGC 1976']),
    'all around the pole': (0.0, 89.0, 12.0, ['NGC 188'], []),
    'across 0 h, from the west': (358.0, 57.0, 12.0, ['NGC 7789', 'M 52'], []),
    'across 0 h, from the east': (2.0, 57.0, 12.0, ['NGC 7789'], ['M 31'])}


def sky_at(ra_deg: float, dec_deg: float, fov_deg: float) -> SkyMapping:
    return SkyMapping(Camera.from_fov(1024, 768, fov_deg),
                      quaternion_from_pointing(*np.radians([ra_deg, dec_deg, 20.0])))


@pytest.mark.parametrize('field', FIELDS)
def test_objects_of_a_field_have_their_best_known_name(field):
    ra_deg, dec_deg, fov_deg, there, absent = FIELDS[field]
    names = [one.name for one in deep_sky_in(sky_at(ra_deg, dec_deg, fov_deg))]
    assert set(there) <= set(names) and not set(absent) & set(names)
    assert len(names) == len(set(names))


@pytest.mark.parametrize('fov_deg', [0.5, 2.0, 10.0, 50.0, 100.0])
def test_a_field_has_only_as_many_names_as_it_has_room_for(fov_deg):
    """In the Coma cluster, Virgo and the middle of the Galaxy, the most crowded places."""
    for ra_deg, dec_deg in ((194.9, 27.9), (187.5, 12.5), (270.0, -23.0)):
        sky = sky_at(ra_deg, dec_deg, fov_deg)
        found = deep_sky_in(sky)
        assert len(found) <= 40
        assert all(sky.camera.contains(sky.pixels(one.direction[None])).all() for one in found)
        assert all(2 * one.semi_axes_rad[0] > np.radians(fov_deg) / 70 or one.name[0] == 'M'
                   for one in found)


def test_the_outline_of_andromeda_is_along_its_axis():
    """M 31 is 3 deg long and points 35 deg east of north."""
    sky = sky_at(10.7, 41.3, 11.0)
    m31 = next(one for one in deep_sky_in(sky) if one.name == 'M 31')
    outline = m31.outline()
    far = outline[np.argmax(np.linalg.norm(outline - m31.direction, axis=1))]
    far = far if far[2] > m31.direction[2] else 2 * m31.direction - far
    length_deg = np.degrees(2 * np.linalg.norm(far - m31.direction))
    assert 2.5 < length_deg < 3.5
    north = unit_from_radec(*np.radians([10.6847, 41.27])) + [0, 0, 1e-3] - m31.direction
    north -= m31.direction * (north @ m31.direction)
    angle = np.degrees(np.arccos((far - m31.direction) @ north / np.linalg.norm(north)
                                 / np.linalg.norm(far - m31.direction)))
    assert abs(angle - 35) < 3
    # Its outline is in the picture, and nothing without it.
    black, nothing = np.zeros((768, 1024), np.uint8), (np.empty((0, 2)), np.empty(0, int))
    with_it = annotated(black, *nothing, sky, 2026.5, deep_sky=[m31])
    without = annotated(black, *nothing, sky, 2026.5)
    u, v = sky.pixels(outline).round().astype(int).T
    assert (with_it[v, u] != without[v, u]).any(axis=1).mean() > 0.9
    assert not (with_it != without)[:100].any()


def test_a_photograph_has_the_bubble_nebula_and_its_caption(sky_data, tmp_path):
    image = next((sky_data / 'night-sky-11deg').glob('*Alt40_Azi45*.png'))
    pictures = []
    for name, deep_sky in (('with', True), ('without', False)):
        outputs = Outputs(tmp_path / name, deep_sky=deep_sky)
        row, = solve_files([image], fov_deg=11.4, epoch_year=2019.57, outputs=outputs).rows
        assert row['solved']
        pictures.append(cv2.imread(row['written'][0]))
    with_it, without = pictures
    # One more line of the caption, and three objects: M 52, NGC 7635 and NGC 7789.
    assert with_it.shape[0] > without.shape[0]
    assert (with_it[:768] != without[:768]).any(axis=2).sum() > 300


def test_without_the_library_it_is_said_before_work(sky_data, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pyongc', None)
    with pytest.raises(MissingLibraryError, match='Naming deep-sky objects needs Py') as caught:
        solve_files([sky_data / 'none.png'], outputs=Outputs(tmp_path, deep_sky=True))
    assert install_hint('deep-sky') in str(caught.value)
