# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Databases are shared, bounded in memory, and gone with their owner."""

from dataclasses import replace
import errno
import gc
import hashlib
import os
from pathlib import Path
import subprocess
import sys
import weakref

from limits import HANGS_S
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA, synthetic_field
from startracker_ros.core import folders, stored_arrays
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import load_deep_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.folders import cache_folder
from startracker_ros.core.identify.cache import cached_brightest, cached_pairs
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.registry import METHODS
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.stored_arrays import prepare, resident_bytes
from startracker_ros.io.images.images import read_image
from startracker_ros.photographs import solve
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.sky_levels import SkyLevels
from startracker_ros.photographs.sky_quads import sky_quads
from startracker_ros.photographs.sky_triangles import sky_triangles

BRIGHT = IdentificationOptions(magnitude_limit=5.0)
RECORDED = {
    1: '9138a28f44de102d6051a243bdbb18a1d4421b9745898394621756af86695683',
    3: 'fcad0ee6f7bef53675eecfa07bedffd205865288fb7ae410c9dd19b5af646971',
    4: 'd6d49e5a73c888a535a40dd9cf8aec9f4d4e6d04de319fabe1f1897d9667c893',
    5: 'd4bded6bad4bed712a8282939ebe94ca7ddf87509e03068101fc0cea912d8bed'}
"""Digest of what is built, by the FORMAT that it has."""
NIGHT_SKY = Path(__file__).parents[2] / 'data' / 'night-sky-11deg'


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))


@pytest.fixture
def no_garbage_collection():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def made(key, size=1000):
    return stored_arrays.stored_arrays('pairs', key, lambda: {
        'numbers': np.arange(size, dtype=np.int32), 'none': np.zeros((0, 3)),
        'one': np.array(2.5), 'flags': np.array([True, False])})


def copied_kb(stored):
    """Return the memory in kB that this process has in addition to that of the file of arrays."""
    address = stored.arrays['numbers'].__array_interface__['data'][0]
    lines = iter(Path('/proc/self/smaps').read_text().splitlines())
    for line in lines:
        first = line.split()[0]
        if '-' in first and not first.endswith(':'):
            low, high = (int(end, 16) for end in first.split('-'))
            inside = low <= address < high
        elif inside and first == 'Anonymous:':
            return int(line.split()[1])
    raise AssertionError('the arrays are not mapped')


def test_arrays_come_back_as_they_were_stored(own_cache):
    made('a')
    stored = made('a')
    assert stored.mapped_bytes == next(cache_folder().iterdir()).stat().st_size
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))
    assert stored.arrays['none'].shape == (0, 3) and stored.arrays['one'] == 2.5
    assert stored.arrays['flags'].tolist() == [True, False]
    for array in stored.arrays.values():
        assert array.flags.writeable and array.flags.aligned and array.flags.c_contiguous


def test_what_is_read_is_not_copied(own_cache):
    stored = made('a', 1_000_000)
    assert stored.arrays['numbers'].sum() and copied_kb(stored) == 0


def test_pages_that_were_given_back_are_read_again(own_cache):
    stored = made('a')
    stored.populate()
    stored.give_back()
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))


def test_a_mapped_file_may_be_replaced_or_deleted(own_cache):
    stored = made('a')
    file, = cache_folder().iterdir()
    other = file.with_suffix('.other')
    other.write_bytes(b'of another process')
    other.rename(file)
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))
    assert made('a').mapped_bytes == stored.mapped_bytes
    file.unlink()
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))


def test_without_space_arrays_are_in_memory(own_cache, monkeypatch, caplog):
    def no_space(file, arrays):
        file.write(b'half')
        raise OSError(errno.ENOSPC, 'No space left on device')
    monkeypatch.setattr(stored_arrays, 'write_arrays', no_space)
    stored = made('a')
    assert not stored.mapped_bytes and not list(cache_folder().iterdir())
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))
    assert 'No space left on device' in caplog.text
    prepare(stored)


def test_other_content_has_another_format(own_cache):
    """
    A file of before would be read as what the code of now builds.

    Where this fails, what is built or stored has changed: raise FORMAT of stored_arrays.py and
    add its digest to RECORDED. Where neither was meant to change, something is wrong.
    """
    catalog = load_catalog().brighter_than(4.5)
    onboard = cached_brightest(catalog, CAMERA, 2015.0, 3.5, 30.0)
    levels = SkyLevels(lambda: catalog, 2015.0, [
        Camera.from_fov(1024, 768, fov_deg) for fov_deg in (90.0, 60.0)], 10.0)
    pairs = [cached_pairs(onboard, 0.01, 0.3, brightest=brightest) for brightest in (None, 100)]
    quads = [sky_quads(catalog, 2015.0, 20.0, 40.0, 3.0, even=even) for even in (False, True)]
    content = hashlib.sha256()
    for stored in (onboard.stored, *(one.stored for one in (*pairs, *quads, levels)),
                   sky_triangles(onboard, 0.1).stored):
        for name, array in stored.arrays.items():
            # The last bits may differ between machines.
            content.update(f'{name} {array.dtype} {array.shape}'.encode())
            content.update((array if array.dtype.kind != 'f' else
                            np.rint(array.astype(float) * 1e6).astype(int)).tobytes())
    for column in vars(load_deep_catalog()).values():
        content.update(column[::1000].tobytes() if isinstance(column, np.ndarray) else b'')
    made('layout')
    content.update(next(cache_folder().glob(
        f'pairs-{stored_arrays.digest(stored_arrays.FORMAT, "layout")[:32]}.bin')).read_bytes())
    assert {stored_arrays.FORMAT: content.hexdigest()}.items() <= RECORDED.items()


def limit(monkeypatch, databases):
    """Limit the cache to databases of so many bytes."""
    monkeypatch.setenv(folders.CACHE_VARIABLE, str(1e-6 * (databases + 1)))


def test_the_cache_is_bounded_whatever_is_in_it(own_cache, monkeypatch):
    folder = cache_folder()
    (folder / 'compiled_code').mkdir(parents=True)
    # As of earlier versions.
    names = ['triangles-1.bin', 'quads-2.bin', 'pairs-3-4.part', 'compiled_code/a.code']
    for age, name in enumerate(names):
        (folder / name).write_bytes(bytes(100_000))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    size = made('new').mapped_bytes
    assert len([*folder.rglob('*.*')]) == len(names) + 1
    limit(monkeypatch, size + 50_000)
    made('newer')
    left = {path.name for path in folder.rglob('*') if path.is_file()}
    assert not left & {Path(name).name for name in names}
    assert len(left) == 2


SEARCH = """
import numpy as np
from startracker_ros.core.stored_arrays import stored_arrays
stored = [stored_arrays('pairs', key, lambda: print(key, end='') or {'a': np.zeros(size)})
          for key, size in zip('abcdef', (3000, 1000, 2000, 1000, 2500, 1000))]
"""


def test_a_search_of_more_than_fits_keeps_what_it_can(own_cache, monkeypatch):
    limit(monkeypatch, 8.1 * 8000)
    built = [subprocess.run([sys.executable, '-c', SEARCH], capture_output=True, text=True,
                            check=True, timeout=HANGS_S).stdout for _ in range(3)]
    # One of the last that it needs is built again.
    assert built == ['abcdef', 'e', 'e']
    assert 8 * 8000 < sum(file.stat().st_size for file in cache_folder().iterdir()) < 8.1 * 8000


@pytest.mark.parametrize('text, megabytes', [('', 800), ('1000', 1000), ('0', 0), ('much', 800),
                                             ('-1', 800)])
def test_the_size_of_the_cache_is_that_of_the_environment(monkeypatch, caplog, text, megabytes):
    monkeypatch.setenv(folders.CACHE_VARIABLE, text)
    assert folders.most_cache_bytes() == 1e6 * megabytes
    assert ('not a size in MB' in caplog.text) == (text in ('much', '-1'))


def test_prepared_arrays_are_bounded(own_cache, monkeypatch):
    many = [made(str(n)) for n in range(6)]
    size = many[0].mapped_bytes
    given_back = []
    monkeypatch.setattr(stored_arrays.StoredArrays, 'give_back',
                        lambda stored: given_back.append(many.index(stored)))
    before = resident_bytes()
    monkeypatch.setattr(stored_arrays, 'MOST_RESIDENT_BYTES', 3 * size)
    monkeypatch.setattr(stored_arrays, '_resident', weakref.WeakKeyDictionary())
    for n in (0, 1, 2, 0, 3):
        prepare(many[n])
    assert given_back == [1] and resident_bytes() == 3 * size
    # What is used at once stays, whatever its size.
    prepare(*many)
    assert given_back[1:] == [] and resident_bytes() == 6 * size
    prepare(many[5])
    assert given_back[1:] == [0, 1, 2]
    del many[3:]
    assert resident_bytes() == 0 and before >= 0


@pytest.mark.parametrize('method', METHODS)
def test_a_database_dies_with_its_identifier(method, no_garbage_collection):
    def make():
        identifier = make_identifier(CAMERA, 2026.0, IdentificationOptions(
            method=method, magnitude_limit=5.0))
        identifier.identify(synthetic_field(identifier.onboard, CAMERA)[0])
        return identifier
    identifier = make()
    onboard = weakref.ref(identifier.onboard)
    stored = weakref.ref(identifier.onboard.stored)
    del identifier
    assert onboard() is None and stored() is None


@pytest.mark.parametrize('make', [
    lambda: IdentificationStage(CAMERA, 2026.0, BRIGHT).identifier,
    lambda: make_track_filter(CAMERA, 2026.0).sky])
def test_a_catalogue_dies_with_its_stage(make, no_garbage_collection):
    owner = make()
    onboard = weakref.ref(owner.onboard)
    del owner
    assert onboard() is None


def databases():
    return [weakref.ref(one) for one in gc.get_objects()
            if isinstance(one, stored_arrays.StoredArrays)]


@pytest.mark.parametrize('camera', [Camera.from_fov(1024, 768, 11.4), None])
def test_databases_die_with_the_solver(camera, no_garbage_collection):
    image = read_image(sorted(NIGHT_SKY.glob('*.png'))[2])
    before = len(databases())
    solver = PhotographSolver(2019.57)
    assert solver.solve(image, camera).quaternion is not None
    during = len(databases())
    del solver
    assert len(databases()) == before < during


def test_databases_die_with_a_call_of_solve(no_garbage_collection):
    paths = sorted(NIGHT_SKY.glob('*.png'))[:1]
    before = len(databases())
    result = solve.solve_files(paths, fov_deg=11.4, epoch_year=2019.57)
    assert result.rows[0]['solved'] and len(databases()) == before


def test_searches_of_one_database_share_its_catalogue():
    database = PyramidIdentifier(CAMERA, 2020.0, BRIGHT)
    other = database.with_camera(replace(CAMERA, fy=0.9 * CAMERA.fy), BRIGHT)
    assert other.onboard is database.onboard and other.pairs is database.pairs
    kept = [array.__array_interface__['data'][0] for array in other.native_patterns()[1]]
    # Nothing is copied.
    assert database.onboard.grid.start.__array_interface__['data'][0] in kept
    assert database.onboard.direction.__array_interface__['data'][0] in kept
    assert database.pairs.member.__array_interface__['data'][0] in kept
