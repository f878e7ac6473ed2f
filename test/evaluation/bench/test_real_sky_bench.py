# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs with known answers, ours compared with peers."""

import csv
from pathlib import Path
import shutil

import numpy as np
import pytest
from scipy.spatial import cKDTree
from startracker_evaluation.bench import astap, astrometry_net
from startracker_evaluation.bench.real_sky import run_real_sky_bench
from startracker_ros.core.catalog.deep import load_deep_catalog
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


# What astap_cli 2022.11.11 wrote of the same image.
INI = """PLTSOLVD=T
CRPIX1= 5.1250000000000000E+002
CRPIX2= 3.8450000000000000E+002
CRVAL1= 2.3066087000000000E+002
CRVAL2= 1.1031400000000000E+001
"""


def test_the_centre_that_astap_writes_is_that_of_the_image(one_known_image):
    row = one_known_image[1]
    known = unit_from_radec(*np.radians([float(row['ra_deg']), float(row['dec_deg'])]))
    assert np.degrees(np.linalg.norm(astap.centre(INI) - known)) < 0.05
    assert astap.centre('PLTSOLVD=F') is None


def test_the_database_of_astap_has_every_star_once_in_its_area(tmp_path):
    """Read as the comments of the source of ASTAP describe it."""
    astap.write_database(tmp_path)
    catalog = load_deep_catalog()
    files = sorted(tmp_path.glob('v17_*.290'))
    assert len(files) == 290
    ra, dec, magnitude, area = [], [], [], []
    for number, path in enumerate(files):
        content = path.read_bytes()
        assert content[109] == 5
        records = np.frombuffer(content[110:], np.uint8).reshape(-1, 5).astype(int)
        raw = records[:, 0] | records[:, 1] << 8 | records[:, 2] << 16
        head = raw == 0xFFFFFF
        assert head[0]
        group = np.cumsum(head) - 1
        high, tenths = records[head, 3] - 128, records[head, 4] - 16
        star = ~head
        ra.append(raw[star] * 2 * np.pi / (2 ** 24 - 1))
        dec.append((high[group[star]] * 65536 + records[star, 4] * 256 + records[star, 3])
                   * np.pi / 2 / (2 ** 23 - 1))
        magnitude.append(tenths[group[star]] / 10)
        assert (np.diff(magnitude[-1]) >= 0).all()
        area.append(np.full(star.sum(), number))
    ra, dec, magnitude, area = map(np.concatenate, (ra, dec, magnitude, area))
    assert len(ra) == len(catalog)
    np.testing.assert_allclose(np.sort(magnitude), np.sort(catalog.magnitude), atol=0.051)
    distance, _ = cKDTree(catalog.directions(2019.5)).query(unit_from_radec(ra[::97], dec[::97]))
    assert distance.max() < 1e-6
    # Limits of the rings and areas, of the table there: of 02_01 and 09_32.
    for name, low, high, first, last in (('0201', -85.23224404, -75.66348756, 0, 90),
                                         ('0932', -12.79440589, 0, 348.75, 360)):
        inside = area == [path.stem[4:] for path in files].index(name)
        assert low <= np.degrees(dec[inside]).min() and np.degrees(dec[inside]).max() <= high
        assert first <= np.degrees(ra[inside]).min() and np.degrees(ra[inside]).max() <= last
    wide = np.fromfile(tmp_path / 'w08_0101.001', '<f4')[1:].reshape(-1, 3)
    assert len(wide) == np.count_nonzero(catalog.magnitude <= 8.0)
    assert wide[0, 0] == -14 and abs(np.degrees(wide[0, 1]) - 101.3) < 0.1
