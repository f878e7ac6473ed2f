# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sky file that `startracker sky` writes, by a reader of its own, and damaged."""

import json
from pathlib import Path
import subprocess
import sys
import zlib

from commands import invoke
from limits import HANGS_S
import numpy as np
import pytest
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.native import check_sky, NativeError
from startracker_ros.core.stored_arrays import mapped_arrays, StoredArraysError
from startracker_ros.ros.processes import node_environment

# As native/README.md has them.
HEADER = np.dtype([('magic', 'S8'), ('byte_order', 'u4'), ('checksum', 'u4'), ('bytes', 'u8'),
                   ('layout', 'u4'), ('sections', 'u4'), ('reserved', 'u1', 32)])
SECTION = np.dtype([('name', 'S24'), ('type', 'S8'), ('offset', 'u8'), ('shape', 'u8', 2),
                    ('dimensions', 'u4'), ('reserved', 'u4')])
# Two processes with the same file and the same catalogue of the cache, until their input ends.
PROCESS = """
import sys
import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.stored_arrays import mapped_arrays
from pathlib import Path
sections = mapped_arrays(Path(sys.argv[1])).arrays
stars = camera_stars(Camera.from_fov(1024, 1024, 20.0), 2026.0)
total = sections['pair_separation'].sum() + sections['direction'].sum() + stars.direction.sum()
print(total, flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    """Return a sky file, and what the command said of it."""
    path = tmp_path_factory.mktemp('sky') / 'camera.sky'
    done = invoke('sky', '-o', str(path), '--fov-deg', '20', '--epoch', '2026.3',
                  '--magnitude-limit', '4', '--json')
    assert done.exit_code == 0, done.stderr
    return path, json.loads(done.stdout)


@pytest.fixture(scope='module')
def sections(written):
    """Return the arrays of the file, read by NumPy alone."""
    content = written[0].read_bytes()
    header = np.frombuffer(content, HEADER, 1)[0]
    assert header['magic'] == b'STARRAYS' and header['byte_order'] == 0x01020304
    assert header['layout'] == 1
    assert header['bytes'] == len(content) and header['checksum'] == zlib.crc32(content[16:])
    arrays = {}
    for one in np.frombuffer(content, SECTION, header['sections'], HEADER.itemsize):
        shape = tuple(int(along) for along in one['shape'][:one['dimensions']])
        assert one['offset'] % 64 == 0
        arrays[one['name'].decode()] = np.frombuffer(
            content, one['type'].decode(), int(np.prod(shape)), int(one['offset'])).reshape(shape)
    return arrays


def test_the_library_accepts_what_is_written(written):
    check_sky(written[0])


def test_the_command_says_what_is_in_the_file(written, sections):
    path, said = written
    counts = {row['part']: row['count'] for row in said['rows']}
    assert counts == {'stars': len(sections['hip']),
                      'pattern stars': len(sections['pattern_member']),
                      'pairs': len(sections['pair_separation']),
                      'pairs of the brightest': len(sections['bright_separation'])}
    assert said['conditions']['epoch_year'] == sections['epoch_year'] == 2026
    assert said['conditions']['size_mb'] == pytest.approx(1e-6 * path.stat().st_size)
    assert sections['band'].tobytes() == said['conditions']['band'].encode() == b'V'
    assert sections['sky'] == 1 and sections['pattern_limit'] == 4


def test_stars_are_those_of_the_catalogue(sections):
    catalog = load_catalog()
    place = {hip: row for row, hip in enumerate(catalog.hip)}
    row = np.array([place[hip] for hip in sections['hip']])
    alone = np.abs(sections['magnitude'] - catalog.magnitude[row]) < 1e-6
    assert alone.mean() > 0.98 and (np.diff(sections['magnitude']) >= 0).all()
    np.testing.assert_allclose(
        sections['direction'][alone],
        catalog.directions(2026.0, earth_position_au(2026.0))[row[alone]], rtol=0, atol=1e-15)
    mas_yr = np.degrees(np.linalg.norm(sections['motion'], axis=1)[alone]) * 3.6e6
    known = np.hypot(catalog.pm_ra_mas_yr, catalog.pm_dec_mas_yr)[row[alone]]
    # With the motion along the line of sight, which a few have, and as distances are now.
    assert np.median(np.abs(mas_yr - known)) < 1e-3 and np.mean(np.abs(mas_yr - known) > 1) < 1e-3


@pytest.mark.parametrize('part, stars', [('', 'hip'), ('pattern_', 'pattern_member')])
def test_each_star_is_in_its_cell(sections, part, stars):
    cells, start, member = (sections[f'{part}{name}'] for name in ('cells', 'start', 'member'))
    direction = sections['direction'][:len(sections[stars])]
    along = np.clip(np.floor((direction + 1) * cells / 2).astype(int), 0, cells - 1)
    cell = (along[:, 0] * cells + along[:, 1]) * cells + along[:, 2]
    np.testing.assert_array_equal(cell[member], np.repeat(np.arange(cells ** 3), np.diff(start)))
    assert set(member) == set(range(len(direction)))


def test_pairs_are_all_of_the_separations(sections):
    star = np.flatnonzero(~sections['crowded'][:len(sections['pattern_member'])])
    np.testing.assert_array_equal(sections['pair_star'], star)
    direction = sections['direction'][star]
    np.testing.assert_array_equal(sections['pair_direction'], direction)
    first, second = np.triu_indices(len(star), 1)
    chord = np.linalg.norm(direction[first] - direction[second], axis=1)
    low, high = (2 * np.sin(sections[name] / 2) for name in ('least_rad', 'most_rad'))
    inside = (chord >= low) & (chord <= high)
    expected = sorted(zip(first[inside], second[inside]))
    member = np.sort(sections['pair_member'].reshape(-1, 2), axis=1)
    assert sorted(map(tuple, member.tolist())) == expected
    np.testing.assert_allclose(2 * np.sin(sections['pair_separation'] / 2), np.linalg.norm(
        direction[member[:, 0]] - direction[member[:, 1]], axis=1), rtol=0, atol=1e-15)


@pytest.mark.parametrize('part', ['pair', 'bright'])
def test_pairs_are_in_order_and_linked(sections, part):
    separation, below, member, previous = (
        sections[f'{part}_{name}'] for name in ('separation', 'below', 'member', 'previous'))
    assert (np.diff(separation) >= 0).all()
    line = np.linspace(separation[0], separation[-1], len(separation) + 1)
    # A separation that is on the line, but for rounding, is on either side.
    away = np.abs(below - np.searchsorted(separation, line))
    assert away[1:-1].max() <= 1 and (away > 0).mean() < 1e-3 and below[-1] == len(separation)
    last = {}
    for entry, star in enumerate(member.tolist()):
        assert previous[entry] == last.get(star, -1)
        last[star] = entry


def of_another_version(content):
    """Return a file of the same layout with sections of version 2."""
    header = np.frombuffer(content, HEADER, 1)[0]
    table = np.frombuffer(content, SECTION, header['sections'], HEADER.itemsize)
    other = bytearray(content)
    other[int(table['offset'][table['name'] == b'sky'][0])] ^= 3
    other[12:16] = zlib.crc32(other[16:]).to_bytes(4, sys.byteorder)
    return other


@pytest.mark.parametrize('damage, of_library, of_package', [
    (lambda content: b'', 'it is empty', 'it is not a file of this package'),
    (lambda content: content[:40], 'bytes of the file = 40', 'it is not a file of this package'),
    (lambda content: content[:-64], 'bytes of the file', 'it does not have the'),
    (lambda content: b'SIMPLE  ' + content[8:], 'first byte of a sky file',
     'it is not a file of this package'),
    (lambda content: content[:8] + content[8:12][::-1] + content[12:], 'mark of the byte order',
     'on a machine of another byte order'),
    (lambda content: content[:24] + b'\2\0\0\0' + content[28:], 'version of the layout = 2',
     'it was written by another version'),
    (of_another_version, 'sky = 2 is not within 1 .. 1', None),
    (lambda content: content[:-1] + b'\1', 'checksum of the file', 'it is damaged')],
    ids=['empty', 'a piece', 'truncated', 'another file', 'foreign', 'layout', 'version', 'bits'])
def test_a_damaged_file_is_refused(written, tmp_path, damage, of_library, of_package):
    other = tmp_path / 'damaged.sky'
    other.write_bytes(damage(written[0].read_bytes()))
    with pytest.raises(NativeError, match=f'damaged.sky: .*{of_library}'):
        check_sky(other)
    if of_package is not None:
        with pytest.raises(StoredArraysError, match=f'damaged.sky: .*{of_package}'):
            mapped_arrays(other)


def memory_kb(pid: int, name: str) -> dict[str, int]:
    """Return the memory of a process in files of a name, by kind."""
    kinds, inside = {'Rss': 0, 'Pss': 0, 'Anonymous': 0}, False
    for line in Path(f'/proc/{pid}/smaps').read_text().splitlines():
        first, *rest = line.split()
        if not first.endswith(':'):
            inside = name in line
        elif inside and first[:-1] in kinds:
            kinds[first[:-1]] += int(rest[0])
    return kinds


def test_processes_share_the_pages(written):
    path, _ = written
    processes = [subprocess.Popen(
        [sys.executable, '-c', PROCESS, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True, env=node_environment()) for _ in range(2)]
    try:
        assert len({one.stdout.readline() for one in processes}) == 1
        for one in processes:
            for name in (path.name, 'catalogue-'):
                memory = memory_kb(one.pid, name)
                assert memory['Rss'] > 1000 and memory['Anonymous'] == 0
                assert memory['Pss'] < 0.6 * memory['Rss']
    finally:
        for one in processes:
            one.communicate(timeout=HANGS_S)


@pytest.mark.parametrize('arguments, status, text', [
    (('--camera', __file__, '--fov-deg', '5'), 2, 'give either --fov-deg or --camera'),
    (('--camera', 'no.yaml'), 1, 'no.yaml'), (('--epoch', '1066'), 2, '--epoch'),
    (('--band', 'K'), 2, '--band')])
def test_wrong_use(tmp_path, arguments, status, text):
    path = tmp_path / 'a.sky'
    done = invoke('sky', '-o', str(path), *arguments)
    assert done.exit_code == status and text in done.stderr and not path.exists()


def test_what_cannot_be_written_is_said_before_the_work(tmp_path):
    done = invoke('sky', '-o', str(tmp_path / 'no' / 'a.sky'), '--fov-deg', '7.77')
    assert done.exit_code == 1 and f'{tmp_path}/no/a.sky: No such file' in done.stderr
