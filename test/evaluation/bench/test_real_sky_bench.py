# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs with known answers, ours compared with peers."""

import csv
from pathlib import Path
import shutil

import numpy as np
import pytest
from startracker_evaluation.bench import astrometry_net
from startracker_evaluation.bench.real_sky import run_real_sky_bench
from startracker_ros.core.maths.rotation import unit_from_radec

FOLDER = Path(__file__).parents[2] / 'data' / 'night-sky-11deg'

# What solve-field 0.93 printed of the first image of the folder.
PRINTED = """
Field 1: solved with index index-tycho2-15.littleendian.fits.
Field: a.png
Field center: (RA,Dec) = (230.667495, 11.036240) deg.
Field size: 11.4269 x 8.58505 degrees
"""


@pytest.fixture
def one_known_image(tmp_path):
    with (FOLDER / 'solutions.csv').open(newline='') as file:
        row = next(csv.DictReader(file))
    with (tmp_path / 'solutions.csv').open('w', newline='') as file:
        table = csv.DictWriter(file, row)
        table.writeheader()
        table.writerow(row)
    shutil.copy(FOLDER / row['file'], tmp_path)
    return tmp_path, row


def test_each_solver_is_counted_by_camera_and_over_all(one_known_image):
    result = run_real_sky_bench([one_known_image[0]])
    rows = {(row.images, row.detection, row.solver): row for row in result.rows}
    group = one_known_image[0].name
    whole = rows[group, 'startracker solve', 'ours']
    assert (whole.correct, whole.wrong, whole.silent) == (1, 0, 0)
    assert {key[1:] for key in rows if key[0] == group} == {
        key[1:] for key in rows if key[0] == 'all' and key[1] != 'any of'}
    # tetra3rs is among what the tests install.
    peers = next(row for key, row in rows.items() if key[1] == 'any of')
    assert peers.correct >= rows['all', 'tetra3rs', 'tetra3rs'].correct
    assert peers.correct + peers.wrong + peers.silent == 1


def test_the_centre_that_astrometry_net_prints_is_that_of_the_image(one_known_image):
    row = one_known_image[1]
    known = unit_from_radec(*np.radians([float(row['ra_deg']), float(row['dec_deg'])]))
    assert np.degrees(np.linalg.norm(astrometry_net.centre(PRINTED) - known)) < 0.001
    assert astrometry_net.centre('Field 1 did not solve.') is None


def test_without_its_index_files_it_is_absent_and_said(monkeypatch, tmp_path):
    monkeypatch.setattr(astrometry_net, 'INDEX_FILES', tmp_path)
    assert astrometry_net.version().startswith('absent: apt install astrometry.net')
