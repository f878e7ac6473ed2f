# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Databases are shared, bounded in memory, and gone with their owner."""

from dataclasses import replace
import errno
import gc
from pathlib import Path
import weakref

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core import stored_arrays
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.folders import cache_folder
from startracker_ros.core.identify.identification import IdentificationOptions, METHODS
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.photograph import PhotographSolver
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.stored_arrays import prepare, resident_bytes
from startracker_ros.io.images.images import read_image
from startracker_ros.tools.photographs import solve

BRIGHT = IdentificationOptions(magnitude_limit=5.0)
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
    """Return the memory in kB that this process has beside that of the file of arrays."""
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
    # Of the type that functions are compiled for.
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
    monkeypatch.setattr(stored_arrays, '_write', no_space)
    stored = made('a')
    assert not stored.mapped_bytes and not list(cache_folder().iterdir())
    np.testing.assert_array_equal(stored.arrays['numbers'], np.arange(1000))
    assert 'No space left on device' in caplog.text
    prepare(stored)


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
        identifier.warm_up()
        return identifier
    # The compiler keeps the arguments that it loads a function for.
    make()
    gc.collect()
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
    assert other.verifier.data.sky.start is database.verifier.data.sky.start
    assert other.verifier.data.sky.direction is database.onboard.direction
