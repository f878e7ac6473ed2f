# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pair database: complete, and cached without ever being trusted blindly."""

import logging
import os

import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core import folders, stored_arrays
from startracker_ros.core.folders import cache_folder
from startracker_ros.core.identify.cache import cached_pairs
from startracker_ros.core.identify.pairs import build_pairs

NEAR, FAR = 0.005, 0.2


@pytest.fixture(scope='module')
def onboard():
    return onboard_stars(CAMERA, 2026.0, 4.0)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))


def assert_equal(a, b):
    for name in ('star', 'direction', 'separation', 'below', 'member', 'previous'):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def replace_file(file, content):
    """Replace a file, which may be mapped, by another one."""
    other = file.with_suffix('.other')
    other.write_bytes(content)
    other.rename(file)


def test_every_pair_of_lone_stars_is_there_once(onboard):
    pairs = build_pairs(onboard, NEAR, FAR)
    lone = np.flatnonzero(~onboard.crowded)
    assert 0 < len(lone) < len(onboard)
    np.testing.assert_array_equal(pairs.star, lone)
    direction = onboard.direction[lone]
    cross = np.linalg.norm(np.cross(direction[:, None], direction[None]), axis=2)
    angle = np.triu(np.arctan2(cross, direction @ direction.T), 1)
    expected = np.argwhere((angle >= NEAR) & (angle <= FAR))
    ours = np.sort(np.stack([pairs.first, pairs.second], -1), axis=1)
    assert sorted(map(tuple, ours)) == sorted(map(tuple, expected))
    assert (np.diff(pairs.separation) >= 0).all()
    np.testing.assert_allclose(pairs.separation, angle[tuple(ours.T)], atol=1e-12)


def test_pairs_between_come_in_both_orders(onboard):
    pairs = build_pairs(onboard, NEAR, FAR)
    a, b = pairs.between(0.1, 0.11)
    half = len(a) // 2
    assert half == np.count_nonzero((pairs.separation >= 0.1) & (pairs.separation <= 0.11)) > 0
    np.testing.assert_array_equal(a[:half], b[half:])
    np.testing.assert_array_equal(b[:half], a[half:])


def test_the_cache_gives_back_what_was_built(onboard):
    built = cached_pairs(onboard, NEAR, FAR)
    file, = cache_folder().iterdir()
    written = file.stat().st_ino
    assert_equal(cached_pairs(onboard, NEAR, FAR), built)
    assert file.stat().st_ino == written


def test_the_cache_keeps_what_was_used_last(onboard, monkeypatch):
    def added(max_separation_rad, used_s):
        before = set(cache_folder().glob('*'))
        cached_pairs(onboard, NEAR, max_separation_rad)
        file, = set(cache_folder().iterdir()) - before
        os.utime(file, (used_s, used_s))
        return file
    first, second = added(0.19, 100), added(0.18, 200)
    # Of a process that was killed while it wrote.
    left = cache_folder() / 'pairs-abc.part'
    left.write_bytes(bytes(first.stat().st_size))
    os.utime(left, (50, 50))
    cached_pairs(onboard, NEAR, 0.19)
    sizes = first.stat().st_size + second.stat().st_size
    monkeypatch.setenv(folders.CACHE_VARIABLE, str(1e-6 * (sizes - 1)))
    cached_pairs(onboard, NEAR, 0.17)
    assert first.exists() and not second.exists() and not left.exists()
    assert len(list(cache_folder().iterdir())) == 2
    assert sum(file.stat().st_size for file in cache_folder().iterdir()) <= sizes


def test_a_file_that_another_process_deletes_is_not_an_error(onboard, monkeypatch, caplog):
    cached_pairs(onboard, NEAR, 0.19)
    gone = [cache_folder() / 'pairs-gone.bin']
    monkeypatch.setattr(folders.Path, 'glob', lambda folder, pattern: gone)
    built = cached_pairs(onboard, NEAR, 0.18)
    assert not caplog.text and len(list(cache_folder().iterdir())) == 2
    assert_equal(cached_pairs(onboard, NEAR, 0.18), built)


def test_the_cache_is_keyed_by_what_it_was_built_from(onboard):
    cached_pairs(onboard, NEAR, FAR)
    cached_pairs(onboard, NEAR, 0.19)
    other = onboard_stars(CAMERA, 2027.0, 4.0)
    cached_pairs(other, NEAR, FAR)
    assert len(list(cache_folder().iterdir())) == 3


def test_a_database_of_another_format_is_left_alone(onboard, monkeypatch):
    built = cached_pairs(onboard, NEAR, FAR)
    old, = cache_folder().iterdir()
    # Whatever another version has put there under its own key.
    replace_file(old, b'another layout')
    monkeypatch.setattr(stored_arrays, 'FORMAT', stored_arrays.FORMAT + 1)
    assert_equal(cached_pairs(onboard, NEAR, FAR), built)
    assert old.read_bytes() == b'another layout' and len(list(cache_folder().iterdir())) == 2


@pytest.mark.parametrize('damage', [
    lambda content: b'', lambda content: content[:20], lambda content: content[:-1],
    lambda content: content[:5000] + bytes([content[5000] ^ 1]) + content[5001:],
    lambda content: b'something else altogether' * 100])
def test_a_damaged_cache_is_built_anew_and_replaced(onboard, caplog, damage):
    built = cached_pairs(onboard, NEAR, FAR)
    file, = cache_folder().iterdir()
    content = file.read_bytes()
    replace_file(file, damage(content))
    with caplog.at_level(logging.WARNING):
        assert_equal(cached_pairs(onboard, NEAR, FAR), built)
    assert 'is damaged and is rebuilt' in caplog.text
    assert file.read_bytes() == content


def test_without_a_cache_folder_it_only_takes_longer(onboard, tmp_path, monkeypatch, caplog):
    (tmp_path / 'file').write_text('in the way')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'file'))
    assert_equal(cached_pairs(onboard, NEAR, FAR), build_pairs(onboard, NEAR, FAR))
    assert 'is not cached' in caplog.text
