# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A catalogue of the user: how it is made, what it refuses, narrow fields that it solves."""

import csv
import errno
import gzip
import json
import os

from astropy.io import fits
from astropy.table import Table
from commands import invoke
import numpy as np
import pyarrow
from pyarrow import parquet
import pytest
from startracker_evaluation.bench import own_catalogue
from startracker_evaluation.bench.own_catalogue import (
    image_of_sky, random_spots, run_own_catalogue_bench, simulated_stars, solve_list)
import startracker_ros as st
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import TILED_OFFSET
from startracker_ros.core.catalog.stars import CATALOG_EPOCH_YEAR
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, quaternion_from_pointing, unit_from_radec)
from startracker_ros.io.images.images import read_photograph
from startracker_ros.photographs.ladder import REFERENCE_YEAR
from startracker_ros.photographs.sky_quads import quad_table, quads_of
from startracker_ros.photographs.tiled import (
    Fields, Place, QUAD_DENSITY, QUAD_INNER, side_range_deg, TiledIdentifier)
from startracker_ros.photographs.tiles import (
    CatalogueError, COLUMNS, DESCRIPTION, double_precision, QUADS, TiledCatalogue)
from startracker_ros.tools.catalogue import build
from startracker_ros.tools.catalogue.build import build_catalogue
from startracker_ros.tools.figures.correctness import is_wrong

# A part of the sky 8 deg high, as deep as G 14.5 is on average, across right ascension 0.
RA_DEG, DEC_DEG, HALF_DEG, STARS = 0.0, 40.0, 4.0, 30_000
YEAR = own_catalogue.EPOCH_YEAR


def stars(count=STARS, seed=1):
    rng = np.random.default_rng(seed)
    dec = np.degrees(np.arcsin(rng.uniform(*np.sin(np.radians(
        [DEC_DEG - HALF_DEG, DEC_DEG + HALF_DEG])), count)))
    ra = RA_DEG + rng.uniform(-1, 1, count) * HALF_DEG / np.cos(np.radians(DEC_DEG))
    return {'ra': ra % 360, 'dec': dec, 'pmra': rng.normal(0, 20, count),
            'pmdec': rng.normal(0, 20, count),
            'phot_g_mean_mag': 14.5 + np.log10(rng.uniform(1e-4, 1, count)) / 0.4}


def write_csv(path, table, opened=open):
    with opened(path, 'wt', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*(column.tolist() for column in table.values())))
    return path


@pytest.fixture(scope='module')
def catalogue(tmp_path_factory):
    folder = tmp_path_factory.mktemp('own')
    table = write_csv(folder / 'stars.csv', stars())
    build_catalogue([table], folder / 'catalogue', epoch_year=2016.0, least_deg=0.3)
    return TiledCatalogue(folder / 'catalogue')


def inside(rng):
    """Return the attitude of an image in the part of the sky that has stars."""
    return quaternion_from_pointing(*np.radians(
        [RA_DEG + rng.uniform(-3, 3), DEC_DEG + rng.uniform(-3, 3), rng.uniform(0, 360)]))


@pytest.mark.slow
@pytest.mark.parametrize('near', [True, False], ids=['near', 'blind'])
@pytest.mark.parametrize('known', [True, False], ids=['known field', 'any field'])
@pytest.mark.parametrize('fov_deg', [
    0.3, *(pytest.param(fov_deg, marks=pytest.mark.long) for fov_deg in (0.4, 0.6, 1.2))])
def test_narrow_fields_are_found_among_false_spots(catalogue, monkeypatch, fov_deg, known, near):
    """A fifth of the stars is missing, ten spots are false, brightness is off by 0.3 mag."""
    identifier, rng = TiledIdentifier(catalogue, YEAR), np.random.default_rng(int(100 * fov_deg))
    monkeypatch.setattr(own_catalogue, 'random_attitude', inside)
    camera = Camera.from_fov(own_catalogue.WIDTH, own_catalogue.HEIGHT, fov_deg)
    place = Place.near(RA_DEG + 1, DEC_DEG - 1, 5.0) if near else None
    fields = identifier.fields_about(camera if known else None, 0.05, place)
    solved, images = 0, 8
    for _ in range(images):
        centroids, q = image_of_sky(catalogue, fov_deg, rng)
        found = solve_list(identifier, centroids, fields, place)
        if found is not None:
            assert not is_wrong(*found, q)
            solved += 1
    # Of a hundred simulated images of each kind at least 95 are solved.
    assert solved >= images - 2


def test_the_bench_measures_each_search(catalogue, monkeypatch):
    monkeypatch.setattr(own_catalogue, 'random_attitude', inside)
    rows = run_own_catalogue_bench(trials=2, seed=1, stars=0, folder=catalogue.folder,
                                   only=['0.6 deg']).rows
    found = {row.case: row.ours for row in rows}
    assert len(found) == len(rows) == 24
    for search in ('near', 'near, any field', 'blind', 'blind, any field'):
        assert found[f'0.6 deg, {search}: wrong'] == 0
        assert found[f'0.6 deg, {search}: solved'] >= 50
        assert found[f'0.6 deg, {search}: time, p99'] > 0


def test_the_simulated_sky_is_denser_towards_the_milky_way():
    table = simulated_stars(20_000, np.random.default_rng(1))
    assert table['phot_g_mean_mag'].max() <= 14.2 and np.abs(table['dec']).max() <= 90
    direction = unit_from_radec(np.radians(table['ra']), np.radians(table['dec']))
    # The north galactic pole (ESA SP-1200, vol. 1, section 1.5.3).
    pole = unit_from_radec(*np.radians([192.85948, 27.12825]))
    sine = direction @ pole
    near, far = np.count_nonzero(np.abs(sine) < 0.17), np.count_nonzero(np.abs(sine) > 0.87)
    # Shares of the sky: what the sine spans of -1 to 1.
    assert near / 0.17 > 4 * far / 0.13


@pytest.mark.slow
@pytest.mark.parametrize('near', [True, False], ids=['near', 'blind'])
def test_random_spots_are_not_a_field(catalogue, near):
    identifier, rng = TiledIdentifier(catalogue, YEAR), np.random.default_rng(3)
    place = Place.near(RA_DEG, DEC_DEG, 5.0) if near else None
    for _ in range(6):
        fields = identifier.fields(place)
        assert solve_list(identifier, random_spots(rng), fields, place) is None


def test_a_mirrored_field_is_not_a_field(catalogue, monkeypatch):
    monkeypatch.setattr(own_catalogue, 'random_attitude', inside)
    identifier = TiledIdentifier(catalogue, YEAR)
    centroids, _ = image_of_sky(catalogue, 0.6, np.random.default_rng(3))
    assert solve_list(identifier, centroids, identifier.fields(None), None) is not None
    flipped = st.Centroids([own_catalogue.WIDTH - 1, 0] + centroids.uv * [-1, 1], centroids.flux,
                           centroids.snr, centroids.sigma_px)
    assert solve_list(identifier, flipped, identifier.fields(None), None) is None


@pytest.mark.slow
def test_the_quads_of_the_whole_sky_are_made_part_by_part(tmp_path, monkeypatch):
    """They are those that would be made of all stars at once."""
    monkeypatch.setattr(build, '_SLAB_STARS', 2000)
    monkeypatch.setattr(build, '_PIECE', 7000)
    table = write_csv(tmp_path / 'stars.csv', stars())
    build_catalogue([table], tmp_path / 'parts', epoch_year=2016.0, least_deg=0.3)
    parts = TiledCatalogue(tmp_path / 'parts')
    assert len(build._slabs(parts.grid)) > 3
    direction = double_precision(parts.grid.direction)
    order = np.argsort(parts.array('magnitude'), kind='stable')
    code, star, side = quads_of(direction[order], *side_range_deg(Fields(0.3, 2.0)), QUAD_DENSITY,
                                even=True, inner=QUAD_INNER)
    whole = quad_table(code, order[star].astype(np.int32), side)
    assert len(whole.code) > 10_000
    code, star, side, start = map(parts.array, QUADS)
    np.testing.assert_array_equal(start, whole.start)
    # In a cell they may be in another order.
    order, expected = np.lexsort(star.T), np.lexsort(whole.star.T)
    np.testing.assert_array_equal(star[order], whole.star[expected])
    np.testing.assert_array_equal(code[order], whole.code[expected])
    np.testing.assert_array_equal(side[order], whole.side[expected])


@pytest.mark.parametrize('kind', ['csv.gz', 'fits', 'parquet', 'vizier'])
def test_all_formats_give_the_same_catalogue(tmp_path, kind):
    table, path = stars(3000), tmp_path / f'stars.{kind}'
    # A star without a proper motion, one without a magnitude.
    table['pmra'][7] = table['pmdec'][7] = table['phot_g_mean_mag'][9] = np.nan
    build_catalogue([write_csv(tmp_path / 'stars.csv', table)], tmp_path / 'expected',
                    epoch_year=2016.0, least_deg=0.3, blind=False)
    dated = {**table, 'ref_epoch': np.full(3000, 2016.0)}
    columns = {}
    if kind == 'csv.gz':
        write_csv(path, dated, gzip.open)
    elif kind == 'fits':
        Table(dated).write(path)
    elif kind == 'parquet':
        parquet.write_table(pyarrow.table(dated), path)
    else:
        names = {'ra': 'RAJ2000', 'dec': 'DEJ2000', 'pmra': 'pmRA', 'pmdec': 'pmDE',
                 'phot_g_mean_mag': 'brightness', 'ref_epoch': 'Epoch'}
        lines = [';'.join(names.values())]
        lines += [';'.join('' if np.isnan(value) else repr(float(value)) for value in row)
                  for row in zip(*dated.values())]
        path.write_text('# from VizieR\n' + '\n'.join(lines))
        columns = {'magnitude': 'brightness'}
    result = build_catalogue([path], tmp_path / 'found', columns=columns, least_deg=0.3,
                             blind=False)
    assert result.rows[0]['stars'] == 2999 and result.rows[0]['left_out'] == 1
    expected, found = (TiledCatalogue(tmp_path / name) for name in ('expected', 'found'))
    for name in (*COLUMNS, 'direction', 'start'):
        np.testing.assert_array_equal(found.array(name), expected.array(name))


def test_stars_move_from_the_epoch_of_the_file(tmp_path):
    """Along the great circle of a motion of more than an arcsecond a year."""
    ra, dec, pmra, pmdec = 316.7, 38.8, 1000.0, -800.0
    table = {'ra': np.array([ra]), 'dec': np.array([dec]), 'pmra': np.array([pmra]),
             'pmdec': np.array([pmdec]), 'mag': np.array([4.8])}
    build_catalogue([write_csv(tmp_path / 'one.csv', table)], tmp_path / 'one', epoch_year=2016.0,
                    least_deg=0.3)
    catalogue = TiledCatalogue(tmp_path / 'one')
    star = catalogue.stars(np.array([0]))
    assert star.hip[0] == TILED_OFFSET
    at, east = np.radians([ra, dec]), np.radians([ra + 90, 0])
    north = np.radians([ra + 180, 90 - dec])
    for year, direction in ((2016.0, star.directions(2016.0)), (2030.0, star.directions(2030.0)),
                            (CATALOG_EPOCH_YEAR, star.directions(CATALOG_EPOCH_YEAR)),
                            (REFERENCE_YEAR, catalogue.grid.direction)):
        moved = (unit_from_radec(*at) + (year - 2016.0) * ARCSEC / 1000 * (
            pmra * unit_from_radec(*east) + pmdec * unit_from_radec(*north)))
        moved /= np.linalg.norm(moved)
        # A hundredth of an arcsecond: directions of the search are of single precision.
        assert np.linalg.norm(direction[0] - moved) < 0.015 * ARCSEC


def changed(name, values):
    table = stars(50)
    table[name] = np.asarray(values, table[name].dtype)
    return table


BAD_TABLES = {
    'no column of the magnitude; name it with --column magnitude=NAME, there are ra, dec':
        {name: stars(5)[name] for name in ('ra', 'dec', 'pmra')},
    'dec is 100, not within -90 to 90': changed('dec', np.full(50, 100.0)),
    'no column of the epoch: give --epoch': stars(50),
    'no stars with position and magnitude':
        {**changed('phot_g_mean_mag', np.full(50, np.nan)), 'ref_epoch': np.full(50, 2016.0)},
}


@pytest.mark.parametrize('words', BAD_TABLES)
def test_a_table_that_will_not_do_is_named(tmp_path, words):
    path = write_csv(tmp_path / 'bad.csv', BAD_TABLES[words])
    result = invoke('catalogue', str(path), '--output', str(tmp_path / 'out'))
    assert result.exit_code == 1 and words in result.stderr and str(path) in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert [file.name for file in tmp_path.iterdir()] == ['bad.csv']


@pytest.mark.parametrize('content, words', [
    (b'\x89PNG\r\n\x1a\n\x00\xff\xfe', 'neither CSV nor a FITS table nor Parquet'),
    (b'PAR1 and no more', 'pyarrow cannot read it'),
    (b'\x1f\x8b\x08\x00 cut', 'stars.any: '),
    (b'ra,dec,mag\n1,2,3\n4,5\n', 'row 2 has 2 values, the header 3 names'),
    (b'ra,dec,mag\n1,2,3\n4,x,5\n', "row 2: dec is 'x', no number"),
    (b'', 'no column of the right ascension'),
    (None, 'No such file')])
def test_a_file_of_another_kind_is_named(tmp_path, content, words):
    path = tmp_path / 'stars.any'
    if content is not None:
        path.write_bytes(content)
    result = invoke('catalogue', str(path), '--output', str(tmp_path / 'out'), '--epoch', '2016')
    assert result.exit_code == 1 and words in result.stderr, result.stderr
    assert len(result.stderr.splitlines()) == 1 and not (tmp_path / 'out').exists()


def test_an_image_is_not_a_table(tmp_path):
    path = tmp_path / 'image.fits'
    fits.PrimaryHDU(np.zeros((4, 4))).writeto(path)
    result = invoke('catalogue', str(path), '--output', str(tmp_path / 'out'))
    assert result.exit_code == 1 and 'a FITS file without a table' in result.stderr


def test_a_full_disk_leaves_the_catalogue_before(tmp_path, monkeypatch):
    path, out = write_csv(tmp_path / 'stars.csv', stars(500)), tmp_path / 'out'
    build_catalogue([path], out, epoch_year=2016.0, least_deg=0.3)
    before = (out / DESCRIPTION).read_text()

    def full(descriptor, offset, size):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, 'posix_fallocate', full)
    result = invoke('catalogue', str(path), '--output', str(out), '--epoch', '2016')
    assert result.exit_code == 1 and 'No space left on device' in result.stderr
    assert f'{tmp_path}: ' in result.stderr and 'MB are free' in result.stderr
    assert (out / DESCRIPTION).read_text() == before
    assert {file.name for file in tmp_path.iterdir()} == {'stars.csv', 'out'}


def test_a_folder_of_something_else_is_not_replaced(tmp_path):
    path = write_csv(tmp_path / 'stars.csv', stars(500))
    (tmp_path / 'photos').mkdir()
    (tmp_path / 'photos' / 'mine.jpg').write_bytes(b'mine')
    result = invoke('catalogue', str(path), '--output', str(tmp_path / 'photos'),
                    '--epoch', '2016')
    assert result.exit_code == 1 and 'it is there and no catalogue' in result.stderr
    assert (tmp_path / 'photos' / 'mine.jpg').read_bytes() == b'mine'


def test_a_catalogue_is_replaced(tmp_path):
    path, out = write_csv(tmp_path / 'stars.csv', stars(500)), tmp_path / 'out'
    for faintest, count in ((20, 500), (13.5, None)):
        row = build_catalogue([path], out, epoch_year=2016.0, faintest=faintest,
                              least_deg=0.3).rows[0]
        assert count is None or row['stars'] == count
    assert TiledCatalogue(out).description['faintest'] <= 13.5
    assert {file.name for file in tmp_path.iterdir()} == {'stars.csv', 'out'}


@pytest.fixture
def small(tmp_path):
    out = tmp_path / 'out'
    build_catalogue([write_csv(tmp_path / 'stars.csv', stars(500))], out, epoch_year=2016.0,
                    least_deg=0.3)
    return out


def damage(folder, how):
    file = folder / DESCRIPTION
    description = json.loads(file.read_text())
    if how == 'another version':
        file.write_text(json.dumps({**description, 'version': 99}))
    elif how == 'cut description':
        file.write_text(file.read_text()[:40])
    elif how == 'no description':
        file.unlink()
    elif how == 'cut array':
        with (folder / 'direction.npy').open('r+b') as array:
            array.truncate(1000)
    elif how == 'no array':
        (folder / 'quad_star.npy').unlink()


@pytest.mark.parametrize('how, words', [
    ('another version', 'catalogue of version 99, this program reads'),
    ('cut description', 'catalogue.json is damaged'),
    ('no description', 'no catalogue, catalogue.json is missing'),
    ('cut array', 'direction.npy has 1000 of'),
    ('no array', 'quad_star.npy has 0 of')])
def test_a_damaged_folder_is_named(small, sky_data, how, words):
    damage(small, how)
    image = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[0]
    result = invoke('solve', str(image), '--catalogue', str(small))
    assert result.exit_code == 1 and words in result.stderr, result.stderr
    assert str(small) in result.stderr and 'startracker catalogue' in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_folder_that_is_not_there_is_named(tmp_path, sky_data):
    image = sorted((sky_data / 'night-sky-11deg').glob('*.png'))[0]
    with pytest.raises(CatalogueError, match='no such folder'):
        st.solve(image, catalogue=tmp_path / 'nowhere')


def picture(catalogue, fov_deg, rng):
    """Return an image (H, W) of a field of the catalogue, its attitude."""
    camera, q = Camera.from_fov(1024, 768, fov_deg), inside(rng)
    matrix = matrix_from_quaternion(q)
    found = catalogue.stars(catalogue.rows_near(matrix[:, 2], camera.corner_angle_rad))
    uv = camera.project(found.directions(YEAR) @ matrix)
    image = rng.normal(500, 12, (768, 1024))
    y, x = np.mgrid[-5:6, -5:6]
    for (u, v), magnitude in zip(uv, found.magnitude):
        column, row = round(float(u)), round(float(v))
        if 6 < column < 1017 and 6 < row < 761:
            square = (x - (u - column)) ** 2 + (y - (v - row)) ** 2
            image[row - 5:row + 6, column - 5:column + 6] += (
                10 ** (-0.4 * (magnitude - 17.5)) * 60 * np.exp(-square / (2 * 1.3 ** 2)))
    return np.clip(image, 0, 65535).astype(np.uint16), q


@pytest.mark.slow
def test_images_are_solved_by_command_and_library(catalogue, tmp_path):
    image, q = picture(catalogue, 0.4, np.random.default_rng(5))
    axis = matrix_from_quaternion(q)[:, 2]
    ra_deg = float(np.degrees(np.arctan2(axis[1], axis[0]))) % 360
    header = fits.Header({'OBJCTRA': '00 04 00', 'OBJCTDEC': '+39 30 00', 'ROWORDER': 'TOP-DOWN'})
    fits.PrimaryHDU(image, header).writeto(tmp_path / 'field.fits')
    # A field that is given wrong is as none.
    for arguments in (('--near', f'{ra_deg + 1:.3f}', '41'), ('--fov-deg', '0.41'), (),
                      ('--fov-deg', '0.6')):
        result = invoke('solve', str(tmp_path / 'field.fits'), '--catalogue',
                        str(catalogue.folder), '--epoch', str(YEAR), '--json', *arguments)
        row = json.loads(result.stdout)['rows'][0]
        assert row['solved'], row['reason']
        assert row['fov_deg'] == pytest.approx(0.4, rel=2e-3)
        assert abs((row['ra_deg'] - ra_deg + 180) % 360 - 180) * 3600 < 40
    solution = st.solve(image, catalogue=catalogue.folder, near_deg=(RA_DEG, DEC_DEG), epoch=YEAR)
    assert solution.matched >= 10
    # The library has the aberration of the Earth's velocity, 20 arcsec.
    error = attitude_error(solution.quaternion, q)
    assert np.hypot(*error[:2]) < 30 * ARCSEC


@pytest.mark.parametrize('cards, pointing_deg', [
    ({'OBJCTRA': '05 30 00', 'OBJCTDEC': '-05 15 00'}, (82.5, -5.25)),
    ({'OBJCTRA': '05:30:36', 'OBJCTDEC': '-00:15:00'}, (82.65, -0.25)),
    ({'RA': 82.5, 'DEC': -5.25}, (82.5, -5.25)),
    ({'RA': 82.5}, None), ({'OBJCTRA': 'M 42', 'OBJCTDEC': ''}, None),
    ({'RA': 82.5, 'DEC': 95.0}, None), ({}, None)])
def test_a_header_says_where_a_mount_is(tmp_path, cards, pointing_deg):
    fits.PrimaryHDU(np.zeros((8, 8), np.uint8), fits.Header(cards)).writeto(tmp_path / 'a.fits')
    found = read_photograph(tmp_path / 'a.fits').pointing_deg
    assert found == (None if pointing_deg is None else pytest.approx(pointing_deg))


@pytest.mark.slow
@pytest.mark.parametrize('near_deg, words', [
    ((180.0, -40.0), 'has no stars within 5 deg of right ascension 180, declination -40'),
    ((RA_DEG, DEC_DEG), 'stars in a field of')])
def test_a_catalogue_that_does_not_cover_an_image_is_named(tmp_path, catalogue, near_deg, words):
    out = tmp_path / 'shallow'
    build_catalogue([write_csv(tmp_path / 'stars.csv', stars())], out, epoch_year=2016.0,
                    faintest=10.0, least_deg=0.3, blind=False)
    image, _ = picture(catalogue, 0.4, np.random.default_rng(5))
    solution = st.solve(image, 0.4, catalogue=out, near_deg=near_deg, epoch=YEAR)
    assert not solution.solved
    assert words in solution.reason and str(out) in solution.reason


def test_arguments_that_do_not_go_together_are_refused(catalogue, tmp_path):
    camera = Camera.from_fov(64, 48, 0.5)
    image = np.zeros((48, 64), np.uint8)
    with pytest.raises(ValueError, match='either catalogue or camera'):
        st.solve(image, camera=camera, catalogue=catalogue.folder)
    with pytest.raises(ValueError, match='give catalogue as well'):
        st.solve(image, near_deg=(0, 0))
    there = tmp_path / 'there'
    there.touch()
    for arguments in (('--near', '1', '2'),
                      ('--near', '1', '95', '--catalogue', str(tmp_path))):
        assert invoke('solve', str(there), *arguments).exit_code == 2
    assert invoke('catalogue', str(there), '-o', 'y', '--column', 'colour=z').exit_code == 2
